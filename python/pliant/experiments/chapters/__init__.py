"""The experiments as chapters of a report: which runs, which numbers, which statements, which pictures.

A chapter is a module with `jobs`, `measure`, `chapter` and `draw`; `demo` walks through them.
"""
