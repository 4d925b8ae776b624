"""Package denoc_ros: ament_python for colcon, an ordinary wheel for pip."""

import importlib.util
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).parent
NAME = 'denoc_ros'
# modules of the nodes, as denoc_ros/parts.py has them: the package cannot be imported here
NODES = {
    **{node: f'nodes.{node}' for node in ('feedforward', 'predictor', 'recorder', 'plant')},
    'viewer': 'viewer.viewer',
    'shaper': 'planning.shaper',
}


def package_version() -> str:
    """Return the version, which stands in package.xml only."""
    version = ElementTree.parse(HERE / 'package.xml').getroot().findtext('version')
    assert version is not None
    return version


def source_commit() -> str:
    """Return the commit of this tree, or the one its sdist was made from; '' if unknown."""
    file = HERE / NAME / 'versions.py'
    specification = importlib.util.spec_from_file_location('versions', file)
    assert specification is not None
    assert specification.loader is not None
    versions = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(versions)
    return str(versions.source_commit(HERE / NAME))


def write_commit(package: Path) -> None:
    """Put the commit beside the modules of a package that is built."""
    commit = source_commit()
    if commit and package.is_dir():
        (package / 'COMMIT').write_text(f'{commit}\n', encoding='utf-8')


class BuildWithCommit(build_py):
    """Build of the modules that says which commit they are of."""

    def run(self) -> None:
        """Build, then add the commit; an editable installation asks git instead."""
        super().run()
        if not getattr(self, 'editable_mode', False):
            write_commit(Path(self.build_lib) / NAME)


class SdistWithCommit(sdist):
    """Source distribution that says which commit it is of."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Make the tree, then add the commit."""
        super().make_release_tree(base_dir, files)
        write_commit(Path(base_dir) / NAME)


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

# the site of the documentation
PAGES = ['README.md', 'CHANGELOG.md', 'CONTRIBUTING.md', 'SECURITY.md', 'CODE_OF_CONDUCT.md']
DOCS = ['sphinx>=8', 'myst-parser>=4', 'furo>=2024.8', 'jupytext>=1.16', 'nbformat>=5.9']

# links from their mesh: tetrahedra, ten-node elements, order of rows, volume meshes of others
REDUCE = ['pytetwild>=0.2,<0.3', 'scikit-fem>=10', 'pymetis>=2025.2', 'meshio>=5.3']

# cross-sections of any outline
SECTIONS = ['sectionproperties>=3.3', 'shapely>=2', 'networkx>=3', 'rtree>=1']

# Nastran's output4 files
NASTRAN = ['pyyeti>=1.4']

# Ansys' .full and .rst files
ANSYS = ['ansys-mapdl-reader>=0.53']

# linear models for python-control's tools
CONTROL = ['control>=0.10']

setup(
    name=NAME,
    version=package_version(),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'nodes/base/*.xml', 'pages/templates/*.j2']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml', *PAGES, 'CITATION.cff', 'LICENSE']),
        *shared_files('config'),
        *shared_files('docs'),
        *shared_files('launch'),
        (f'lib/{NAME}', [f'scripts/{node}' for node in NODES]),
    ],
    python_requires='>=3.10',
    install_requires=[
        'numpy>=1.26',
        'numba>=0.59',
        'scipy>=1.11',
        'clarabel>=0.10',
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
        'docs': DOCS,
        'control': CONTROL,
        'tables': TABLES,
        'mujoco': MUJOCO,
        'reduce': REDUCE,
        'nastran': NASTRAN,
        'ansys': ANSYS,
        'sections': SECTIONS,
        'test': [
            *ANSYS,
            *CLUSTER,
            *CONTROL,
            *DOCS,
            *MUJOCO,
            *NASTRAN,
            *REDUCE,
            *SECTIONS,
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
            'toppra>=0.6.8',
            'casadi>=3.6',
            'mcap-ros2-support',
            'colcon-ros',
            'setuptools<80',  # what colcon takes
        ],
    },
    zip_safe=False,
    maintainer='denoc_ros maintainers',
    description='Real-time model-based control of robots with flexible links under ROS 2',
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    license_files=['LICENSE', 'config/robots/*.LICENSE'],
    keywords=['robotics', 'ROS 2', 'flexible links', 'dynamics', 'feedforward', 'vibration'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Environment :: Console',
        'Intended Audience :: Science/Research',
        'Intended Audience :: Developers',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 14)),
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    cmdclass={'build_py': BuildWithCommit, 'sdist': SdistWithCommit},
    entry_points={
        'console_scripts': [
            'denoc = denoc_ros.cli.main:main',
            *(f'denoc-{node} = denoc_ros.{module}:main' for node, module in NODES.items()),
        ],
    },
)
