"""Package denoc_ros: ament_python for colcon, an ordinary wheel for pip."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).parent
NAME = 'denoc_ros'
NODES = ('feedforward', 'predictor', 'recorder', 'plant', 'viewer', 'shaper')


def package_version() -> str:
    """Return the version, which stands in package.xml only."""
    version = ElementTree.parse(HERE / 'package.xml').getroot().findtext('version')
    assert version is not None
    return version


def shared_files(folder: str) -> list[tuple[str, list[str]]]:
    """Return data_files rows that install a folder's tree below share/denoc_ros."""
    rows: dict[str, list[str]] = {}
    for path in sorted((HERE / folder).rglob('*')):
        if path.is_file() and '__pycache__' not in path.parts:
            relative = path.relative_to(HERE)
            rows.setdefault(f'share/{NAME}/{relative.parent}', []).append(str(relative))
    return list(rows.items())


# whole folders of bags, and Monte Carlo, by several processes or on a cluster
CLUSTER = ['distributed>=2024.8', 'pyarrow>=15']

# the page in the browser, and films
VIEWER = ['viser>=1.0', 'imageio-ffmpeg>=0.5']

# what exported models are compared with
MUJOCO = ['mujoco>=3.17']

# spreadsheets as tables
TABLES = ['openpyxl>=3.1']

# linear models for python-control's tools
CONTROL = ['control>=0.10']

setup(
    name=NAME,
    version=package_version(),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'nodes/*.xml', 'reports/templates/*.j2']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *shared_files('config'),
        *shared_files('launch'),
        (f'lib/{NAME}', [f'scripts/{node}' for node in NODES]),
    ],
    python_requires='>=3.10',
    install_requires=[
        'numpy>=1.26',
        'numba>=0.59',
        'scipy>=1.11',
        'yourdfpy>=0.0.56',
        'lxml>=4.9',
        'pyyaml>=6',
        'mcap>=1.6',
        'zstandard>=0.21',
        'rosbags>=0.11',
        'matplotlib>=3.6',
        'jinja2>=3.1',
        'tqdm>=4.66',
        'trimesh>=4',
    ],
    extras_require={
        'ros': [
            'ros-jazzy-rclpy>=7.1.6',
            'ros-rclpy[fastrtps]==7.1.6',
            'ros-jazzy-common-interfaces',
        ],
        'viewer': VIEWER,
        'cluster': CLUSTER,
        'control': CONTROL,
        'tables': TABLES,
        'mujoco': MUJOCO,
        'test': [
            *CLUSTER,
            *CONTROL,
            *MUJOCO,
            *TABLES,
            *VIEWER,
            'pytest>=8',
            'pytest-xdist>=3.5',
            'playwright>=1.40',
            'hypothesis',
            'ruff',
            'mypy',
            'import-linter',
            'types-PyYAML',
            'pin',
            'example-robot-data',
            'exudyn>=1.13',
            'mcap-ros2-support',
            'colcon-ros',
            'setuptools<80',  # what colcon takes
        ],
    },
    zip_safe=False,
    maintainer='denoc_ros maintainers',
    description='Real-time model-based control of robots with flexible links under ROS 2',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'denoc = denoc_ros.cli.main:main',
            *(f'denoc-{node} = denoc_ros.nodes.{node}:main' for node in NODES),
        ],
    },
)
