"""The chirps of a board as the SDK's configuration has them."""

CFG = """
% a comment
sensorStop
channelCfg 15 5 0
adcCfg 2 1
profileCfg 0 77 7 6 60 0 0 20 1 256 5209 0 0 30
chirpCfg 0 0 0 0 0 0 0 1
chirpCfg 1 1 0 0 0 0 0 4
frameCfg 0 1 16 0 100 1 0
"""
