"""Every effect of the catalogue is exercised by a scenario and documented with a picture of its
residual.
"""

import importlib
import sys
import tomllib
from functools import cache

import numpy as np
import pytest

from tiltcal.core.assets import folder
from tiltcal.design.identifiability import most_similar_effects
from tiltcal.effects import CATALOGUE


def test_every_id_stands_in_a_scenario():
    used = set()
    for path in folder("scenarios").glob("*.toml"):
        used |= {e["id"] for e in tomllib.loads(path.read_text(encoding="utf-8")).get("effect", ())}
    assert set(CATALOGUE) <= used


@cache
def effect_pages():
    """The module that draws the effects' pictures for the site."""
    site = folder("models").parent / "docs" / "site"
    if not site.exists():
        pytest.skip("the documentation lies in the checkout only")
    sys.path.insert(0, str(site))
    try:
        return importlib.import_module("effect_pages")
    finally:
        sys.path.remove(str(site))


@pytest.mark.parametrize("id", list(CATALOGUE))
def test_every_effect_has_a_residual_to_show(id):
    residual = effect_pages().residual_of(id)
    assert residual.channels, id
    assert any(
        np.nanmax(np.abs(values)) > 0 or np.isnan(values).any()
        for values in residual.channels.values()
    ), id


def test_the_rivals_of_sag_are_those_of_its_shape():
    rivals = dict(most_similar_effects("table_sag"))
    assert {"table_encoder_eccentricity", "table_unbalance"} & set(rivals)
    assert all(0 <= cosine <= 1 for cosine in rivals.values())
