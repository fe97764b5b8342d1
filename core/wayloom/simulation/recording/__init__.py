"""Recording of simulated drives: presets, world set-up, resume journal, ground-truth files, training views."""
