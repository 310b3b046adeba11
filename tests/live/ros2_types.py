"""ROS types as the library `cyclonedds` has them, written by hand: they share no code with ours.

There is no `from __future__ import annotations`: the library reads the annotations of its types.
Services have the header of rmw_cyclonedds in front of their fields.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import byte, float32, float64, int32, int64, uint32, uint64

if TYPE_CHECKING:
    sequence = Sequence
    Gids = Sequence[int]
    HumbleGids = Sequence[int]
    Points = Sequence["PointOfInterest"]
    Units = Sequence[float]
    Covariance = Sequence[float]
else:
    from cyclonedds.idl.types import array, sequence

    Gids = array[byte, 16]
    HumbleGids = array[byte, 24]
    Points = array["PointOfInterest", 70]
    Units = array[float32, 99]
    Covariance = array[float64, 36]


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Strange(IdlStruct, typename="lab_msgs.msg.dds_.Strange_"):
    left: int32
    right: int32


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Image(IdlStruct, typename="sensor_msgs.msg.dds_.Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: byte
    step: uint32
    data: sequence[byte]


@dataclass
class AddRequest(IdlStruct, typename="example_interfaces.srv.dds_.AddTwoInts_Request_"):
    guid: uint64
    seq: int64
    a: int64
    b: int64


@dataclass
class AddReply(IdlStruct, typename="example_interfaces.srv.dds_.AddTwoInts_Response_"):
    guid: uint64
    seq: int64
    sum: int64


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common.msg.dds_.Gid_"):
    data: Gids


@dataclass
class Node(IdlStruct, typename="rmw_dds_common.msg.dds_.NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class Nodes(IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[Node]


@dataclass
class NodesName(IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"):
    """Nothing but a name, which is what ROS nodes announce of a type."""

    unknown: byte


@dataclass
class HumbleGid(IdlStruct):
    data: HumbleGids


@dataclass
class HumbleNode(IdlStruct):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[HumbleGid]
    writer_gid_seq: sequence[HumbleGid]


@dataclass
class HumbleNodes(IdlStruct):
    gid: HumbleGid
    node_entities_info_seq: sequence[HumbleNode]


ACTION = "example_interfaces.action.dds_.Fibonacci_"


@dataclass
class GoalId(IdlStruct, typename="unique_identifier_msgs.msg.dds_.UUID_"):
    uuid: Gids


@dataclass
class Goal(IdlStruct, typename=f"{ACTION}Goal_"):
    order: int32


@dataclass
class Result(IdlStruct, typename=f"{ACTION}Result_"):
    sequence: sequence[int32]


@dataclass
class Feedback(IdlStruct, typename=f"{ACTION}Feedback_"):
    sequence: sequence[int32]


@dataclass
class SendGoalRequest(IdlStruct, typename=f"{ACTION}SendGoal_Request_"):
    guid: uint64
    seq: int64
    goal_id: GoalId
    goal: Goal


@dataclass
class SendGoalReply(IdlStruct, typename=f"{ACTION}SendGoal_Response_"):
    guid: uint64
    seq: int64
    accepted: bool
    stamp: Time


@dataclass
class GetResultRequest(IdlStruct, typename=f"{ACTION}GetResult_Request_"):
    guid: uint64
    seq: int64
    goal_id: GoalId


@dataclass
class GetResultReply(IdlStruct, typename=f"{ACTION}GetResult_Response_"):
    guid: uint64
    seq: int64
    status: byte
    result: Result


@dataclass
class FeedbackMessage(IdlStruct, typename=f"{ACTION}FeedbackMessage_"):
    goal_id: GoalId
    feedback: Feedback


@dataclass
class GoalInfo(IdlStruct, typename="action_msgs.msg.dds_.GoalInfo_"):
    goal_id: GoalId
    stamp: Time


@dataclass
class GoalStatus(IdlStruct, typename="action_msgs.msg.dds_.GoalStatus_"):
    goal_info: GoalInfo
    status: byte


@dataclass
class GoalStatusArray(IdlStruct, typename="action_msgs.msg.dds_.GoalStatusArray_"):
    status_list: sequence[GoalStatus]


@dataclass
class CancelRequest(IdlStruct, typename="action_msgs.srv.dds_.CancelGoal_Request_"):
    guid: uint64
    seq: int64
    goal_info: GoalInfo


@dataclass
class CancelReply(IdlStruct, typename="action_msgs.srv.dds_.CancelGoal_Response_"):
    guid: uint64
    seq: int64
    return_code: byte
    goals_canceling: sequence[GoalInfo]


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces.msg.dds_.ParameterValue_"):
    type: byte
    bool_value: bool
    integer_value: int64
    double_value: float64
    string_value: str
    byte_array_value: sequence[byte]
    bool_array_value: sequence[bool]
    integer_array_value: sequence[int64]
    double_array_value: sequence[float64]
    string_array_value: sequence[str]


PARAMETERS = "rcl_interfaces.srv.dds_."


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces.msg.dds_.Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class ListedParameters(IdlStruct, typename="rcl_interfaces.msg.dds_.ListParametersResult_"):
    names: sequence[str]
    prefixes: sequence[str]


@dataclass
class SetResult(IdlStruct, typename="rcl_interfaces.msg.dds_.SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class ListRequest(IdlStruct, typename=f"{PARAMETERS}ListParameters_Request_"):
    guid: uint64
    seq: int64
    prefixes: sequence[str]
    depth: uint64


@dataclass
class ListReply(IdlStruct, typename=f"{PARAMETERS}ListParameters_Response_"):
    guid: uint64
    seq: int64
    result: ListedParameters


@dataclass
class TypesRequest(IdlStruct, typename=f"{PARAMETERS}GetParameterTypes_Request_"):
    guid: uint64
    seq: int64
    names: sequence[str]


@dataclass
class TypesReply(IdlStruct, typename=f"{PARAMETERS}GetParameterTypes_Response_"):
    guid: uint64
    seq: int64
    types: sequence[byte]


@dataclass
class SetRequest(IdlStruct, typename=f"{PARAMETERS}SetParametersAtomically_Request_"):
    guid: uint64
    seq: int64
    parameters: sequence[Parameter]


@dataclass
class SetReply(IdlStruct, typename=f"{PARAMETERS}SetParametersAtomically_Response_"):
    guid: uint64
    seq: int64
    result: SetResult


@dataclass
class SetEachRequest(IdlStruct, typename=f"{PARAMETERS}SetParameters_Request_"):
    guid: uint64
    seq: int64
    parameters: sequence[Parameter]


@dataclass
class SetEachReply(IdlStruct, typename=f"{PARAMETERS}SetParameters_Response_"):
    guid: uint64
    seq: int64
    results: sequence[SetResult]


@dataclass
class GetParametersRequest(IdlStruct, typename="rcl_interfaces.srv.dds_.GetParameters_Request_"):
    guid: uint64
    seq: int64
    names: sequence[str]


@dataclass
class GetParametersReply(IdlStruct, typename="rcl_interfaces.srv.dds_.GetParameters_Response_"):
    guid: uint64
    seq: int64
    values: sequence[ParameterValue]


@dataclass
class AudioData(IdlStruct, typename="audio_common_msgs.msg.dds_.AudioData_"):
    data: sequence[byte]


@dataclass
class AudioInfo(IdlStruct, typename="audio_common_msgs.msg.dds_.AudioInfo_"):
    channels: byte
    sample_rate: uint32
    sample_format: str
    bitrate: uint32
    coding_format: str


@dataclass
class IdsList(IdlStruct, typename="hri_msgs.msg.dds_.IdsList_"):
    header: Header
    ids: sequence[str]


@dataclass
class RegionOfInterest(IdlStruct, typename="hri_msgs.msg.dds_.NormalizedRegionOfInterest2D_"):
    header: Header
    xmin: float32
    ymin: float32
    xmax: float32
    ymax: float32
    c: float32


@dataclass
class PointOfInterest(IdlStruct, typename="hri_msgs.msg.dds_.NormalizedPointOfInterest2D_"):
    x: float32
    y: float32
    c: float32


@dataclass
class Landmarks(IdlStruct, typename="hri_msgs.msg.dds_.FacialLandmarks_"):
    header: Header
    landmarks: Points
    height: uint32
    width: uint32


@dataclass
class Expression(IdlStruct, typename="hri_msgs.msg.dds_.Expression_"):
    header: Header
    expression: str
    valence: float32
    arousal: float32
    confidence: float32


@dataclass
class ActionUnits(IdlStruct, typename="hri_msgs.msg.dds_.FacialActionUnits_"):
    header: Header
    intensity: Units
    confidence: Units


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    pose: Pose
    covariance: Covariance


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TwistStamped_"):
    header: Header
    twist: Twist


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.TwistWithCovariance_"):
    twist: Twist
    covariance: Covariance


@dataclass
class Odometry(IdlStruct, typename="nav_msgs.msg.dds_.Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class Transforms(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs.msg.dds_.LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


FACE_PARTS = {
    "roi": RegionOfInterest, "landmarks": Landmarks, "cropped": Image, "expression": Expression,
    "facs": ActionUnits,
}  # fmt: skip


class Raw:
    """A sample as its bytes."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload

    def serialize(self, **_: Any) -> bytes:
        return self.payload


class RawNodes(Raw):
    """What is said of nodes, in the form of any release."""

    __idl__ = NodesName.__idl__
    __idl_typename__ = NodesName.__idl_typename__

    @classmethod
    def deserialize(cls, payload: bytes) -> Nodes:
        return Nodes.deserialize(payload)

    deserialize_key = deserialize


class RawImage(Raw):
    """The library would go over the pixels one by one."""

    __idl__ = Image.__idl__
    __idl_typename__ = Image.__idl_typename__

    @classmethod
    def deserialize(cls, payload: bytes) -> "RawImage":
        return cls(payload)

    deserialize_key = deserialize


@dataclass
class Name(IdlStruct, typename="lab_msgs.msg.dds_.Strange_"):
    """Nothing but a name, which is what ROS nodes announce of a type."""

    unknown: byte


class RawStrange(Raw):
    """What a ROS node sends of a type that is its own."""

    __idl__ = Name.__idl__
    __idl_typename__ = Name.__idl_typename__
