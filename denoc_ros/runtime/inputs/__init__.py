"""Input messages: read, judged, counted."""
