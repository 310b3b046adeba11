"""Definitions of ROS 2 types: what is in a file, and what its hash is."""

from __future__ import annotations

from pathlib import Path

import pytest

from vertebra.errors import CodecNotFoundError, ConfigError
from vertebra.ros2.definitions import Field, Types


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
