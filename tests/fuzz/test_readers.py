"""Every reader answers every input with a result or one of our errors, in time, in little memory, and in silence."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.fuzz.campaign import Campaign, fuzz, round_of
from tests.fuzz.targets import GROUPS

FIRST = 0  # the round of CI, the same one every time
# A seed that is refused is one for what is behind the refusal: a foreign format, or effects that nobody approved.
REFUSED = {
    "encrypted_ulog": "encrypted", "betaflight": "blackbox_decode", "bundle_edited": "digest does not fit",
    "vehicle": "approved",
}  # fmt: skip


@pytest.fixture(scope="module", params=GROUPS)
def fuzzed(request: pytest.FixtureRequest) -> tuple[dict[str, range], Campaign]:
    """The inputs of a group by target, and how they ended; the seeds are read before their mutations."""
    plan, campaign = round_of(request.param, FIRST), Campaign()
    list(fuzz(request.param, plan, campaign))
    return plan, campaign


def test_mutated_inputs_give_a_result_or_an_error_of_ours(fuzzed: tuple[dict[str, range], Campaign]) -> None:
    plan, campaign = fuzzed
    assert not campaign.finds, "\n\n".join(map(str, campaign.finds))
    assert set(campaign.executions) == set(plan)
    assert all(campaign.executions[name] > len(numbers) for name, numbers in plan.items())  # their seeds as well


def test_seeds_are_read(fuzzed: tuple[dict[str, range], Campaign]) -> None:
    """Mutations of an input that is refused at once would say nothing about what is behind that."""
    plan, campaign = fuzzed
    refused = [text for text in campaign.seeds_refused if REFUSED.get(text.split()[0], "\0") not in text]
    assert refused == []
    refusals = Counter(text.split()[0] for text in campaign.seeds_refused)
    seeds = {name: campaign.executions[name] - len(numbers) for name, numbers in plan.items()}
    only = {name for name, count in refusals.items() if count == seeds[name]}
    assert only <= {"betaflight", "encrypted_ulog", "bundle_edited"}
