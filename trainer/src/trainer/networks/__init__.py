"""Networks from feature images [B, F, R, U] to estimates [B, 1 or 2, R, U]."""
