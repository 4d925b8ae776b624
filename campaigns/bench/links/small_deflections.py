"""How far small deflections reach: the figure of docs/theory.md, and its table.

python -m campaigns deflections docs/small_deflections.png
"""

from __future__ import annotations

import sys

import matplotlib as mpl
from elastica import LOADS, rows, table


def draw(path: str) -> None:
    """Draw the tip's error over its deflection."""
    mpl.use('agg')
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.4), layout='constrained')
    for load, marker in zip(LOADS, 'os', strict=True):
        deflection, full, without, _ = rows(load).T
        label = f'{load} at the tip'
        axes.loglog(deflection, full, f'{marker}-', color='C0', label=label, markersize=4)
        plain = f'{label}, without foreshortening'
        axes.loglog(deflection, without, f'{marker}--', color='C1', label=plain, markersize=4)
    axes.set_xticks([0.05, 0.1, 0.2, 0.3, 0.5], ['5 %', '10 %', '20 %', '30 %', '50 %'])
    axes.set_xticks([], minor=True)
    axes.set_yticks([1e-4, 1e-3, 1e-2, 1e-1], ['0.01 %', '0.1 %', '1 %', '10 %'])
    axes.set_xlabel('deflection of the tip, of the length')
    axes.set_ylabel("distance of the model's tip from the true one, of the length")
    axes.grid(which='both', alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


if __name__ == '__main__':
    draw(sys.argv[1])
    print(table())
