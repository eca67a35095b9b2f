"""Modelica sources as the compiler takes them: the same in other words, where it refuses or mistakes them.

`copies` says in which order a copy of the sources is rewritten:

- `specialised`: calls for operators of records (`overloaded`), copies of redeclared classes, whole paths.
- `buses`, `iterators`, `component_arrays`: what only all files of a model together show.
- `adapted`: the rest, file by file.

`declared_classes` and `typed_classes` look up classes and components; `class_bodies` only finds classes.
"""
