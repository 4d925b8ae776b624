"""The command `denoc`: one file per verb."""
