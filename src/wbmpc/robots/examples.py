"""The built-in robots with which tasks of any robot start where none is given: the one table of code that names robots."""

from __future__ import annotations

#: Of a task by its name; "any": of those that are not here.
EXAMPLES = {"any": "differential-ur10", "tip-over": "swerve-ur10", "two-arms": "pr2"}
