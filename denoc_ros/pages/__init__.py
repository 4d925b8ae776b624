"""The layout of all HTML pages, and figures as inline SVG."""
