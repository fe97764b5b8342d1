"""Triangle models: meshes, solids, vehicles, people, vegetation."""
