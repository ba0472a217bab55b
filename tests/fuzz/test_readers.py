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


@pytest.mark.parametrize("group", GROUPS)
def test_mutated_inputs_give_a_result_or_an_error_of_ours(group: str) -> None:
    plan, campaign = round_of(group, FIRST), Campaign()
    finds = list(fuzz(group, plan, campaign))
    assert not finds, "\n\n".join(map(str, finds))
    assert set(campaign.executions) == set(plan)
    assert all(campaign.executions[name] > len(numbers) for name, numbers in plan.items())  # their seeds as well


@pytest.mark.parametrize("group", GROUPS)
def test_seeds_are_read(group: str) -> None:
    """Mutations of an input that is refused at once would say nothing about what is behind that."""
    campaign = Campaign()
    plan = {name: range(0) for name in round_of(group, FIRST)}
    assert list(fuzz(group, plan, campaign)) == []
    refused = [text for text in campaign.seeds_refused if REFUSED.get(text.split()[0], "\0") not in text]
    assert refused == []
    assert all(campaign.executions[name] for name in plan)
    refusals = Counter(text.split()[0] for text in campaign.seeds_refused)
    only = {name for name, count in refusals.items() if count == campaign.executions[name]}
    assert only <= {"betaflight", "encrypted_ulog", "bundle_edited"}
