"""The pipeline of one drive: stages, their keys, and the embedded run of all of them."""
