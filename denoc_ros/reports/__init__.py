"""Pages, figures and numbers of runs: called from Python, no command line."""
