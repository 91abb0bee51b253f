"""Chapters of the demo's report: one module per chapter, and `common` with shared code.

The module of a chapter has the functions `jobs` (runs), `measure` (numbers), `chapter` (texts and
statements) and `draw` (pictures), which `experiments.demonstration` calls. `generic_arm` contains
all chapters of the report for an arbitrary arm.
"""
