"""Keys: what is accepted, how foreign names map, what intersects; Zenoh itself is the reference."""

from __future__ import annotations

import pytest
import zenoh
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from vertebra.errors import NameMappingError
from vertebra.keys import check_key, check_key_expression, intersects, map_name, unmap_name

# Any text at all, and names that look like those of robots but are full of what Zenoh dislikes.
names = st.one_of(
    st.text(st.characters(exclude_categories=())),
    st.text("ab:/%.@*$#? \t\x00é☃", max_size=20),
)
chunks = st.sampled_from(["a", "b", "ab", "aab", "@a", "*", "**", "a$*", "$*b", "a$*b", "$*a$*"])


@st.composite
def expressions(draw: st.DrawFn) -> str:
    """Draw a key expression that Zenoh and we accept."""
    text = "/".join(draw(st.lists(chunks, min_size=1, max_size=5)))
    try:
        zenoh.KeyExpr(text)
        return check_key_expression(text)
    except (zenoh.ZError, NameMappingError):
        assume(condition=False)
        raise


@given(names)
def test_every_name_comes_back(name: str) -> None:
    assert unmap_name("yarp", map_name("yarp", name)) == name


@given(names, names)
def test_two_names_never_share_a_key(left: str, right: str) -> None:
    assert (map_name("yarp", left) == map_name("yarp", right)) == (left == right)


@given(names)
def test_the_key_of_a_name_is_one_that_wildcards_see(name: str) -> None:
    key = map_name("yarp", name)
    check_key(key)
    assert zenoh.KeyExpr("yarp/**").intersects(zenoh.KeyExpr(key))
    assert not any(chunk.startswith("@") for chunk in key.split("/"))


@given(st.text("abF/%.@0 2", max_size=12))
def test_a_key_below_the_prefix_has_one_name_or_none(rest: str) -> None:
    key = f"yarp/{rest}"
    try:
        name = unmap_name("yarp", key)
    except NameMappingError:
        return
    assert map_name("yarp", name) == key


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("/icub/cam/left:o", "yarp/icub/cam/left:o"),
        ("relative", "yarp/%./relative"),
        ("/a//b/", "yarp/a/%/b/%"),
        ("/@hidden", "yarp/%40hidden"),
        ("/100%", "yarp/100%25"),
        ("/two words", "yarp/two%20words"),
        ("/é", "yarp/é"),
        ("", "yarp/%./%"),
        ("/", "yarp/%"),
    ],
)
def test_names_stay_readable(name: str, key: str) -> None:
    assert map_name("yarp", name) == key


@pytest.mark.parametrize(
    ("key", "position"),
    [("other/a", 0), ("yarp/%zz", 5), ("yarp/%61", 5), ("yarp/a/%C3", 7), ("yarp", 0)],
)
def test_a_key_that_no_name_maps_to_is_refused(key: str, position: int) -> None:
    with pytest.raises(NameMappingError) as caught:
        unmap_name("yarp", key)
    assert caught.value.position == position


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("", 0), ("/a", 0), ("a/", 2), ("a//b", 2), ("a b", 1), ("a/#", 2), ("a?", 1),
        ("a/*", 2), ("a$b", 1), ("a/\x07", 2), ("a/\u200b", 2),
    ],
)  # fmt: skip
def test_a_bad_key_is_refused_with_a_caret_under_the_fault(text: str, position: int) -> None:
    with pytest.raises(NameMappingError) as caught:
        check_key(text)
    assert caught.value.position == position
    *_, quoted, caret = str(caught.value).splitlines()
    assert caret.index("^") == quoted.index("'") + 1 + position


@pytest.mark.parametrize("text", ["**", "a/*/b", "a/$*b", "*/**", "@a/*", "a/**/b"])
def test_key_expressions_are_accepted_as_zenoh_does(text: str) -> None:
    assert check_key_expression(text) == text
    assert str(zenoh.KeyExpr(text)) == text


@pytest.mark.parametrize("text", ["**/**", "**/*", "a*", "a/**b", "", "a b/*", "a/$*", "a$*$*b"])
def test_bad_key_expressions_are_refused(text: str) -> None:
    with pytest.raises(NameMappingError):
        check_key_expression(text)


@settings(max_examples=1000)
@given(st.text("ab*$/@#? ", min_size=1, max_size=8))
def test_what_we_accept_zenoh_accepts(text: str) -> None:
    try:
        check_key_expression(text)
    except NameMappingError:
        return
    zenoh.KeyExpr(text)


@settings(max_examples=1000)
@given(expressions(), expressions())
def test_intersection_is_that_of_zenoh(left: str, right: str) -> None:
    assert intersects(left, right) == zenoh.KeyExpr(left).intersects(zenoh.KeyExpr(right))
