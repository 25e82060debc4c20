"""Classical estimators of angle: one snapshot, any line of virtual elements, all range bins at once."""
