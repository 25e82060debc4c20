"""In which precision a network is computed: fit, predict and evaluate ask here."""

from __future__ import annotations

from collections.abc import Iterable

import torch

from trainer.run.configuration import FitConfig

FLOAT32_INSTEAD = "bf16 networks computed in float32: this processor has no bfloat16 instructions"


def has_bfloat16() -> bool:
    """Whether the processor computes in bfloat16, which halves the time of a step. One that only emulates it takes 4.5
    times as long as in float32."""
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def in_bfloat16(config: FitConfig, device: str) -> bool:
    """Whether a run's network is computed in bfloat16 on a device of this type: where its configuration says so, and on
    a processor that has the instructions."""
    return config.precision == "bf16" and (device != "cpu" or has_bfloat16())


def precision_remark(configs: Iterable[FitConfig]) -> str | None:
    """What a user should know if one of these networks is computed otherwise than its configuration says."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    other = any(config.precision == "bf16" and not in_bfloat16(config, device) for config in configs)
    return FLOAT32_INSTEAD if other else None
