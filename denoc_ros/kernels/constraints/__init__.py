"""Loops and mimic joints: constraint rows, multipliers and their derivatives."""
