"""What networks and estimators are given: frames of datasets, cubes from files, simulated targets."""
