"""Many submaps into one map: registration, joint optimisation, merge."""
