"""The judge of diagnosis: cases with a known truth, answered through the public API, and one line of scores a set.

`python -m benchmarks.verdict` asks; `cases.toml` has every case, `scoring.py` the five outcomes. Nothing here imports
`diagnosis`: another implementation behind `alula.diagnose` is judged by the same cases and rules.
"""
