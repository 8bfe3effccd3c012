"""Mapping: tracks of all robots become segments, submaps, places, decisions, one graph, one map."""
