"""The bundled models on the campaign's test flights: every table of `alula evaluate`.

Needs `alula campaign --out build/campaign_learning`.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.provenance import write_result
from studies.evaluation.run import draw, run
from studies.tables import markdown

ROOT = Path(__file__).resolve().parents[1]
CAMPAIGN, PICTURES = ROOT / "build" / "campaign_learning", ROOT / "build" / "learning" / "pictures"


def main() -> None:
    models = sorted((ROOT / "vehicles").glob("*.pt"))
    results = run([*models, CAMPAIGN], None, mapping=None, timed=True, done=print)
    draw(results, PICTURES)
    head = (
        "Campaign with hidden effects (68 flights): its 8 test flights, of which no model has seen anything. Each "
        "model's card records how it was trained. plant: the model with the hidden effects themselves, moving air "
        "left out."
    )
    write_result("evaluated_models", "The bundled models", "\n\n".join([head, *map(markdown, results.tables)]))


if __name__ == "__main__":
    main()
