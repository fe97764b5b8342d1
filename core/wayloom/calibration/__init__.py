"""A rig's relative lens, learnt by bundle adjustment over the evidence of several of its drives. docs/calibration.md."""
