"""State of the sensor fusion for /diagnostics."""

from __future__ import annotations

import numpy as np

from denoc_ros.estimation.fusion import StrainFusion
from denoc_ros.runtime.status import WARN, Status

SILENT = 0.5  # s without a value after which a fused sensor counts as missing


def fusion_status(fusion: StrainFusion, now: float) -> Status:
    """Counts of each sensor's values, by fate."""
    status = Status('fusion', message='fusing')
    silent = []
    for name, counts, heard in zip(fusion.names, fusion.counts, fusion.heard, strict=True):
        age = now - heard
        status.values[f'{name} age_s'] = 'never' if np.isnan(age) else float(age)
        for cause, count in sorted(counts.items()):
            status.values[f'{name} {cause}'] = count
        if not age < SILENT:
            silent.append(name)
    if silent:
        status.worsen(WARN, f'no recent value from {", ".join(silent)}: the model goes on alone')
    return status
