"""Networks from features of R range bins to estimates [B, 1 or 2, R, U].

Features are images [B, F, R, U]; snapshots [B, 2 C + 1, R, 1] for the unrolled network; covariances [B, 3, R, C * C]
for the direction-of-arrival network.
"""
