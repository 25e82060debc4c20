"""A run: its configuration and folder, its network with features and decoding, what is made with it."""
