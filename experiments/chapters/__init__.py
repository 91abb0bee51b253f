"""The experiments as chapters of a report: runs, numbers, statements, pictures.

A chapter is a module with `jobs`, `measure`, `chapter` and `draw`; `demo` runs them.
"""
