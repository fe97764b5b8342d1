"""Compiled kernels of the pose graph: ordering, sparse factorisation, edges; arrays in, arrays out."""
