"""Definitions of ROS 2 types: what is in a file, and what its hash is."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vertebra.errors import CodecNotFoundError, ConfigError
from vertebra.ros2.definitions import Types
from vertebra.ros2.interface_files import Field


@pytest.fixture(scope="module")
def standard() -> Types:
    return Types.standard()


HASHES = {  # as rosidl of ROS 2 Jazzy wrote them
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "rmw_dds_common/msg/ParticipantEntitiesInfo": (
        "91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
    ),
    "example_interfaces/srv/AddTwoInts": (
        "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    ),
}


@pytest.mark.parametrize("name", HASHES)
def test_hash_is_that_of_rosidl(standard: Types, name: str) -> None:
    assert standard.hash_of(name) == f"RIHS01_{HASHES[name]}"


def test_every_standard_type_is_whole(standard: Types) -> None:
    assert len(list(standard)) > 200
    for name in standard:
        assert standard.hash_of(name).startswith("RIHS01_")


def test_every_form_of_a_field() -> None:
    types = Types()
    text = """
    # a comment
    uint8 FLAG=3           # a constant
    string NAME="a # b"    # another
    char letter
    string<=5 word 'five # 5'
    float64 factor 3.5
    int16[3] three [1, 2, 3]
    uint8[<=4] few
    wstring<=7[] wide
    Header header
    Other[] others
    geometry_msgs/Point point
    """
    types.add_text("lab_msgs/msg/All", text, "All.msg")
    assert types.definition("lab_msgs/msg/All") == (
        Field("letter", "uint8"),
        Field("word", "string", max_text=5),
        Field("factor", "float64"),
        Field("three", "int16", "array", 3),
        Field("few", "uint8", "bounded", 4),
        Field("wide", "wstring", "sequence", max_text=7),
        Field("header", "std_msgs/msg/Header"),
        Field("others", "lab_msgs/msg/Other", "sequence"),
        Field("point", "geometry_msgs/msg/Point"),
    )


def test_action_is_what_rosidl_makes_of_it(standard: Types) -> None:
    name = "example_interfaces/action/Fibonacci"
    assert [str(field) for field in standard.definition(f"{name}_FeedbackMessage")] == [
        "unique_identifier_msgs/msg/UUID goal_id",
        f"{name}_Feedback feedback",
    ]
    assert [str(field) for field in standard.definition(f"{name}_GetResult_Response")] == [
        "int8 status",
        f"{name}_Result result",
    ]


def test_empty_type_has_the_member_that_rosidl_gives_it(standard: Types) -> None:
    (field,) = standard.definition("std_srvs/srv/Empty_Request")
    assert field.name == "structure_needs_at_least_one_member"


def test_folder_of_a_lab(tmp_path: Path) -> None:
    for file, text in {
        "lab_msgs/msg/Pair.msg": "int32 a\nint32 b\n",
        "lab_msgs/srv/Add.srv": "Pair pair\n---\nint64 sum\n",
        "lab_msgs/action/Go.action": "float32 x\n---\nbool there\n---\nfloat32 left\n",
        "lab_msgs/msg/Tall.idl": (
            "module lab_msgs { module msg { struct Tall { sequence<double, 3> few; "
            "string<5> word; wstring wide; uint8 bytes[4]; }; }; };"
        ),
        "lab_msgs/README.md": "no type",
    }.items():
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    types = Types.standard(tmp_path)
    assert "lab_msgs/srv/Add_Request" in types
    assert "lab_msgs/action/Go_SendGoal_Response" in types
    assert types.definition("lab_msgs/msg/Tall") == (
        Field("few", "float64", "bounded", 3),
        Field("word", "string", max_text=5),
        Field("wide", "wstring"),
        Field("bytes", "uint8", "array", 4),
    )


BY_ROSIDL = """// generated from rosidl_adapter/resource/msg.idl.em
// with input from lab_msgs/msg/Tall.msg
// an enum { in a comment }

#include "geometry_msgs/msg/Point.idl"
#include "std_msgs/msg/Header.idl"

module lab_msgs {
  module msg {
    typedef double double__9[9];
    typedef geometry_msgs::msg::Point geometry_msgs__msg__Point__2[2];
    module Tall_Constants {
      const uint8 FLAG = 3;
      const string NAME = "struct { enum E { A }; }";
    };
    @verbatim (language="comment", text=
      "Tall." "\\n" "map<this> is a comment; }")
    struct Tall {
      std_msgs::msg::Header header;

      @unit (value="m")
      @default (value=1.5)
      double height;

      double__9 covariance;
      geometry_msgs__msg__Point__2 ends;
      sequence<string<4>, 6> words;
      wstring<5> wide;
      octet one;
      boolean map;
      sequence<int64> many;
    };
  };
};
"""


def test_idl_as_rosidl_writes_it() -> None:
    types = Types()
    types.add_idl(BY_ROSIDL, "Tall.idl")
    assert types.definition("lab_msgs/msg/Tall") == (
        Field("header", "std_msgs/msg/Header"),
        Field("height", "float64"),
        Field("covariance", "float64", "array", 9),
        Field("ends", "geometry_msgs/msg/Point", "array", 2),
        Field("words", "string", "bounded", 6, max_text=4),
        Field("wide", "wstring", max_text=5),
        Field("one", "byte"),
        Field("map", "bool"),
        Field("many", "int64", "sequence"),
    )


@pytest.mark.parametrize(
    ("member", "told"),
    [
        ("enum Color { RED, GREEN }; struct T { Color color; };", "have no 'enum'"),
        ("union U switch (long) { case 1: long x; };", "have no 'union'"),
        ("bitmask M { A, B };", "have no 'bitmask'"),
        ("struct T { map<string, int32> x; };", "have no 'map<'"),
        ("struct T { wchar x; };", "have no 'wchar'"),
        ("struct T { sequence<sequence<int32>> x; };", "have no 'sequence<sequence'"),
        ("struct T { long double x; };", "float128 x is of no type"),
        ("struct T { int32 x[2][3]; };", "cannot be read"),
        ("struct T : Base { int32 x; };", "cannot be read"),
        ("struct T { };", "cannot be read"),
    ],
)
def test_idl_that_no_message_has_is_refused(member: str, told: str) -> None:
    with pytest.raises(ConfigError, match=rf"Bad\.idl(:3)?: .*{told}"):
        Types().add_idl(f"module lab {{ module msg {{\n\n{member} }}; }};", "Bad.idl")


def test_struct_outside_of_a_package_is_refused() -> None:
    with pytest.raises(ConfigError, match="is called as in 'std_msgs/msg/String'"):
        Types().add_idl("struct T { int32 x; };", "Bad.idl")


@given(st.text(alphabet='struct mdle{}<>;@()"=,/*#\n01:[]aT', max_size=60))
@settings(deadline=None)
def test_any_text_is_a_definition_or_a_config_error(text: str) -> None:
    for whole in (text, f"module a {{ module msg {{ {text} }}; }};"):
        with contextlib.suppress(ConfigError):  # any other error escapes
            Types().add_idl(whole, "Any.idl")
    for name in ("lab/msg/Any", "lab/action/Any"):
        with contextlib.suppress(ConfigError):
            Types().add_text(name, text, "Any")


def test_installed_package_has_each_type_twice(tmp_path: Path) -> None:
    folder = tmp_path / "lab_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Pair.msg").write_text("int32 a\nint32 b\n")
    (folder / "Pair.idl").write_text("what rosidl made of it is not read again")
    assert "lab_msgs/msg/Pair" in Types.standard(tmp_path)


@pytest.mark.parametrize("name", ["1st", "two words", "T-800"])
def test_file_whose_name_is_no_type_is_named(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "lab_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / f"{name}.msg").write_text("int32 a")
    with pytest.raises(ConfigError, match=rf"{name}\.msg: .*a ROS type is called as"):
        Types.standard(tmp_path)


def test_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "lab_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Bad.msg").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match=r"Bad\.msg: this cannot be read"):
        Types.standard(tmp_path)


def test_service_in_idl() -> None:
    types = Types()
    types.add_idl(
        "module lab { module srv { struct Add_Request { int64 a; }; "
        "struct Add_Response { int64 sum; }; }; };",
        "Add.idl",
    )
    assert types.definition("lab/srv/Add_Event")[1].type == "lab/srv/Add_Request"


@pytest.mark.parametrize(
    ("text", "line"),
    [("int32 a\nint32\n", 2), ("int32 a\n\nint32 a", 3), ("# x\nint32 1a", 2), ("int32[ a", 1)],
)
def test_bad_line_is_named(text: str, line: int) -> None:
    with pytest.raises(ConfigError, match=f"Bad.msg:{line}: "):
        Types().add_text("lab/msg/Bad", text, "Bad.msg")


def test_bad_line_in_the_second_part_is_named() -> None:
    with pytest.raises(ConfigError, match=r"Bad\.srv:3: "):
        Types().add_text("lab/srv/Bad", "int32 a\n---\nint32\n", "Bad.srv")


def test_part_that_is_missing_is_named() -> None:
    with pytest.raises(ConfigError, match=r"a \.action has 3 parts, not 2"):
        Types().add_text("lab/action/Bad", "int32 a\n---\nint32 b\n", "Bad.action")


def test_bad_idl_is_named() -> None:
    with pytest.raises(ConfigError, match=r"Bad\.idl: this IDL cannot be read"):
        Types().add_idl("module {", "Bad.idl")


def test_clash_names_both_definitions(standard: Types) -> None:
    with pytest.raises(ConfigError) as caught:
        standard.add_text("std_msgs/msg/String", "string text", "mine/String.msg")
    text = str(caught.value)
    assert "mine/String.msg" in text
    assert "{string text}" in text
    assert "ROS 2 Jazzy says it is {string data}" in text


def test_package_of_a_lab_is_taken_for_the_one_that_we_bring(tmp_path: Path) -> None:
    folder = tmp_path / "audio_common_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "AudioData.msg").write_text("float32[] float32_data")
    types = Types.standard(tmp_path)
    assert [str(field) for field in types.definition("audio_common_msgs/msg/AudioData")] == [
        "float32[] float32_data"
    ]
    assert "audio_common_msgs/msg/AudioInfo" not in types
    assert "hri_msgs/msg/IdsList" in types


def test_package_of_jazzy_is_not_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "action_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "GoalInfo.msg").write_text("unique_identifier_msgs/UUID goal_id\nint32 stamp")
    with pytest.raises(
        ConfigError, match=r"GoalInfo\.msg: action_msgs/msg/GoalInfo is .* ROS 2 Jazzy"
    ):
        Types.standard(tmp_path)


def test_same_definition_again_is_no_clash(standard: Types) -> None:
    standard.add_text("std_msgs/msg/String", "string data  # as ever", "mine/String.msg")


def test_unknown_type_says_what_mends_it(standard: Types) -> None:
    with pytest.raises(CodecNotFoundError, match="VERTEBRA_ROS2_TYPES"):
        standard.definition("lab_msgs/msg/Nothing")


def test_type_that_is_a_part_of_itself_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "lab_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Egg.msg").write_text("Hen[] hens")
    (folder / "Hen.msg").write_text("Egg egg")
    with pytest.raises(ConfigError, match="lab_msgs/msg/Egg > lab_msgs/msg/Hen"):
        Types.standard(tmp_path)


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        Types.standard(tmp_path / "nowhere")
