"""Definitions of the ROS messages that recordings are written as, in the form MCAP stores them."""

_LINE = "=" * 80
_HEADER = """
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
_TIME = """
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_QUATERNION = """
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
"""
_VECTOR = """
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""


def _joined(*parts: str) -> str:
    return f"\n{_LINE}".join(part.rstrip("\n") for part in parts) + "\n"


IMU = _joined(
    """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
""",
    _HEADER,
    _TIME,
    _QUATERNION,
    _VECTOR,
)
TEMPERATURE = _joined(
    """std_msgs/Header header
float64 temperature
float64 variance
""",
    _HEADER,
    _TIME,
)
JOINT_STATE = _joined(
    """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
""",
    _HEADER,
    _TIME,
)
