"""What a set explains where one of its members acts."""

from types import SimpleNamespace

import numpy as np
import pytest

from leactl.gap.search.effect_sets import EffectSet, FurtherEffect

TOUCHING = ("effect", "cogging", "(6.0,)", "cos")


def rows(equation, columns=()):
    return SimpleNamespace(equation=equation, mechanical="free", columns=dict.fromkeys(columns))


def found(taken, left, moved):
    candidate = ("cogging", (6.0,))
    member = FurtherEffect(candidate, 50.0, 1.0, 0.1, (1.0,), ("cos",), np.eye(1), floor=0.0)
    return EffectSet([candidate], [member], [[member]], [], None, taken, left, [moved], {})


EVIDENCE = SimpleNamespace(stack=SimpleNamespace(rows=[rows("free_torque", [TOUCHING]), rows("voltage")]))


@pytest.mark.parametrize(
    ("taken", "left", "moved", "expected"),
    [
        ([90.0, 0.0], [10.0, 0.0], [50.0, 0.0], 0.9),  # what its own channel says
        ([100.0, 0.0], [0.0, 9000.0], [60.0, 40.0], 0.6),  # it balances its own against one that nothing explains
        ([100.0, 0.0], [0.0, 9000.0], [60.0, 0.0], 1.0),  # what happens elsewhere is no business of its own
        ([0.0, 0.0], [50.0, 0.0], [50.0, 0.0], 0.0),
    ],
)
def test_a_member_stands_with_what_is_explained_where_it_acts(taken, left, moved, expected):
    assert found(taken, left, moved).explained(EVIDENCE, 0) == pytest.approx(expected)
