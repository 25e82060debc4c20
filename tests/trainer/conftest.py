"""The trainer's own helpers, beside the tests that use them."""

import sys
from pathlib import Path

import torch

# Networks of a few channels: more threads cost more than they bring, most of all beside other test processes.
torch.set_num_threads(1)

sys.path.append(str(Path(__file__).resolve().parent))
