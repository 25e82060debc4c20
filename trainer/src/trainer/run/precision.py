"""In which precision a network is computed: fit, predict and evaluate ask here."""

from __future__ import annotations

from collections.abc import Iterable

import torch

from trainer.run.configuration import FitConfig

INSTRUCTIONS = ("avx512_bf16", "amx_bf16", "bf16", "sve_bf16")
"""As torch names them, of x86-64 and of ARM64."""
FLOAT32_INSTEAD = "bf16 networks computed in float32: this processor has no bfloat16 instructions"


def has_bfloat16() -> bool:
    """Whether the processor computes in bfloat16; one that only emulates it is slower so than in float32."""
    capabilities = torch.cpu.get_capabilities()
    return any(capabilities.get(name) for name in INSTRUCTIONS)


def in_bfloat16(config: FitConfig, device: str) -> bool:
    """Whether a run's network is computed in bfloat16 on a device of this type: where its configuration says so, and on
    a processor that has the instructions."""
    return config.precision == "bf16" and (device != "cpu" or has_bfloat16())


def precision_remark(configs: Iterable[FitConfig]) -> str | None:
    """What a user should know if one of these networks is computed otherwise than its configuration says."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    other = any(config.precision == "bf16" and not in_bfloat16(config, device) for config in configs)
    return FLOAT32_INSTEAD if other else None
