"""Receiving of uploads: where their bytes are kept, a folder or an object store."""
