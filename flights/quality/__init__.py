"""Is a log good enough, for what, and what would make a better one: the judgement behind `alula inspect`."""

from flights.quality.inspection import Inspection, inspect_log

__all__ = ["Inspection", "inspect_log"]
