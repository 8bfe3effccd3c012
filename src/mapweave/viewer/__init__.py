"""A result or a trace to a viewer; no algorithm ever asks for one."""
