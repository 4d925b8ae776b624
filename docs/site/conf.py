"""Settings of the site: `make docs` here, rosdoc2 on docs.ros.org.

rosdoc2 copies this folder, reads this file from there and names the original in its own conf.py.
"""

import gc
import importlib.util
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
if HERE.name != 'site' or not (HERE.parents[1] / 'package.xml').is_file():
    copied_from = re.search(r'exec\(open\("(.+?)"\)', Path(__file__).read_text(encoding='utf-8'))
    assert copied_from is not None, f'{__file__}: a conf.py of rosdoc2 must name its original'
    HERE = Path(copied_from[1]).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]
# documents are trees that stay: to look for garbage among them takes a sixth of the time
gc.set_threshold(50_000, 20, 100)

# what docs.ros.org has no package of: autodoc stands in for it
NEEDED = ('numba', 'llvmlite', 'yourdfpy', 'mcap', 'zstandard', 'rosbags', 'trimesh', 'clarabel')
NEEDED += ('lz4', 'ruamel', 'rich', 'websockets', 'skfem', 'pytetwild', 'pymetis', 'meshio')
NEEDED += ('sectionproperties', 'shapely', 'ansys', 'pyyeti')
NEEDED += ('viser', 'imageio_ffmpeg', 'distributed', 'pyarrow', 'control', 'openpyxl', 'mujoco')
NEEDED += ('rclpy', 'builtin_interfaces', 'rcl_interfaces', 'rosgraph_msgs', 'std_msgs')
NEEDED += ('sensor_msgs', 'geometry_msgs', 'nav_msgs', 'trajectory_msgs', 'visualization_msgs')
NEEDED += ('std_srvs', 'diagnostic_msgs', 'launch', 'launch_ros')
autodoc_mock_imports = [name for name in NEEDED if importlib.util.find_spec(name) is None]
# kernels are made by numba as they are imported
autodoc_mock_imports += ['denoc_ros.kernels'] * ('numba' in autodoc_mock_imports)

project = 'denoc_ros'
author = 'denoc_ros maintainers'
extensions = ['sphinx.ext.autodoc', 'sphinx.ext.napoleon', 'sphinx.ext.autosummary']
extensions += ['sphinx.ext.linkcode', 'myst_parser', 'site_pages']
root_doc = 'index'
include_patterns = ['index.md', '*.md', 'docs/*.md', 'api/*.rst']
include_patterns += ['docs/examples/*.md', 'docs/notebooks/*.md']
exclude_patterns = ['README.md']
default_role = 'literal'
autosummary_generate = False
autodoc_member_order = 'bysource'
autodoc_inherit_docstrings = False
autodoc_typehints = 'signature'
autodoc_use_type_comments = False
autodoc_type_aliases = {name: name for name in ('Array', 'Mask', 'ArrayLike', 'Wrenches', 'Base')}
add_module_names = False
smartquotes = False
napoleon_google_docstring = False
napoleon_use_rtype = False
# types are words, such as (n,) array: nothing to link to
napoleon_use_param = False
napoleon_use_ivar = True
python_maximum_signature_line_length = 72
toc_object_entries = False
myst_heading_anchors = 6
myst_fence_as_directive = ['math']
# a public name is also where it is defined: two targets, either will do
suppress_warnings = ['ref.python']

html_theme = 'furo' if importlib.util.find_spec('furo') else 'sphinx_rtd_theme'
html_title = 'denoc_ros'
html_static_path = [str(HERE / 'static')]
html_css_files = ['site.css']
html_math_renderer = 'mathml'
html_copy_source = False
html_show_copyright = False

rosdoc2_settings = {
    'enable_autodoc': False,
    'enable_intersphinx': False,
    'override_theme': False,
    'automatically_extend_intersphinx_mapping': False,
    'support_markdown': False,
}


def linkcode_resolve(domain: str, info: dict[str, str]) -> str | None:
    """Return the page of a name's source, as seen from a page of the reference."""
    from site_pages import source_link

    return source_link(info['module'], info['fullname'])
