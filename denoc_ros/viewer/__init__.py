"""The viewer: page in the browser and films; the only importer of viser."""

NO_VISER = 'viser must be importable, got: {}; pip install "denoc_ros[viewer]"'
