"""What the counts of the code find in a small package."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench.counts import counts, main

SOURCES = {
    'kernels/one.py': 'def f(a, b, c, d, e, f, g, h, i, j, k):\n    return a\n',
    'model/two.py': 'class Twin:\n    """D."""\n\n    def f(self):\n        return 1\n',
    'dynamics/three.py': 'def f():\n    from denoc_ros.dynamics.four import g\n    return g\n',
    'dynamics/four.py': 'from denoc_ros.dynamics import three\n\n\nclass Twin:\n    pass\n',
    'dynamics/robot.py': (
        'class Model: pass\nclass Verbs(Model): pass\nclass Robot(Verbs, Model): pass\n'
    ),
    'parts.py': "PARTS = ('planning',)\n",
    'planning/two.py': 'x = 1\n',
    'cli/five.py': 'import rclpy\nArray = 1\nx = robot.arrays.topology\n',
}


@pytest.fixture
def package(tmp_path: Path) -> Path:
    for name, text in SOURCES.items():
        path = tmp_path / 'denoc_ros' / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        (path.parent / '__init__.py').touch()
    return tmp_path


def test_planted_faults_are_counted(package: Path) -> None:
    found = counts(package)
    assert found['kernels with more than 10 arguments'] == 1
    assert found['class names that occur twice'] == ['Twin']
    assert found['classes behind Robot'] == ['Robot', 'Verbs', 'Model']
    circle = ['denoc_ros.dynamics.four', 'denoc_ros.dynamics.three']
    assert found['modules in an import circle'] == circle
    assert found['definitions of Array'] == 1
    assert found['uses of arrays. outside model, dynamics'] == 1
    assert found['file names that occur twice'] == ['two.py']
    assert (found['lines of the core'], found['lines of optional parts']) == (22, 1)
    assert found['lines']['model'] == 5
    assert found['function lines: longest'] == 3


@pytest.mark.long
def test_the_package_is_counted(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    printed = capsys.readouterr().out
    assert 'file names that occur twice: 0' in printed
    assert 'folders with more than 20 files: 0' in printed
    assert 'classes behind Robot: 5: ' in printed
    assert 'modules in an import circle: 0' in printed  # imports for types and in functions too
