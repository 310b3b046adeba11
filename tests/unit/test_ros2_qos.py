"""Who hears whom, and what we ask for so that it works."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from vertebra.ros2.qos import Qos, for_reader, for_writer, mismatch

ANY = st.builds(
    Qos,
    reliability=st.sampled_from(["reliable", "best_effort"]),
    durability=st.sampled_from(["volatile", "transient_local"]),
    depth=st.integers(1, 100),
)


def test_stronger_offer_is_heard() -> None:
    offered = Qos(durability="transient_local")
    assert mismatch(offered, Qos(reliability="best_effort")) == ""


def test_weaker_offer_is_named() -> None:
    reasons = mismatch(Qos(reliability="best_effort"), Qos(durability="transient_local"))
    assert "reliability differs: best_effort is offered, reliable is requested" in reasons
    assert "durability differs: volatile is offered, transient_local is requested" in reasons


@given(st.lists(ANY, max_size=5))
def test_our_reader_hears_every_writer(offered: list[Qos]) -> None:
    requested = for_reader(offered)
    assert all(mismatch(one, requested) == "" for one in offered)


@given(st.lists(ANY, max_size=5))
def test_every_reader_hears_our_writer(requested: list[Qos]) -> None:
    offered = for_writer(requested)
    assert all(mismatch(offered, one) == "" for one in requested)


def test_latched_data_is_asked_for_where_all_offer_it() -> None:
    latched = Qos(durability="transient_local", depth=1)
    assert for_reader([latched]).durability == "transient_local"
    assert for_reader([latched, Qos()]).durability == "volatile"
    assert for_reader([]).durability == "volatile"
