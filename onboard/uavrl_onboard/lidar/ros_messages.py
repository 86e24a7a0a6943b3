"""Definitions of ROS's messages, in its own language; each type stands here once, for recordings and for DDS.

Those of `std_msgs`, `geometry_msgs`, `nav_msgs` and `sensor_msgs` are the same from ROS 2 Humble to Kilted. Those of
`px4_msgs` are the same in its releases 1.15 to 1.18, but for VehicleControlMode.
"""

from __future__ import annotations

SCAN, CLOUD = "velodyne_msgs/msg/VelodyneScan", "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
PX4_ODOMETRY, PX4_CONTROL_MODE = "px4_msgs/msg/VehicleOdometry", "px4_msgs/msg/VehicleControlMode"
PX4_SETPOINT, PX4_OFFBOARD = "px4_msgs/msg/TrajectorySetpoint", "px4_msgs/msg/OffboardControlMode"
HEADER = "std_msgs/msg/Header"
DIAGNOSTICS, MARKERS = "diagnostic_msgs/msg/DiagnosticArray", "visualization_msgs/msg/MarkerArray"

_XYZ = "float64 x\nfloat64 y\nfloat64 z"
DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec",
    HEADER: "builtin_interfaces/Time stamp\nstring frame_id",
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    SCAN: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    "sensor_msgs/msg/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count",
    CLOUD: "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
    "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense",
    "geometry_msgs/msg/Point": _XYZ,
    "geometry_msgs/msg/Vector3": _XYZ,
    "geometry_msgs/msg/Quaternion": f"{_XYZ}\nfloat64 w",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/msg/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    TWIST: "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/msg/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    TWIST_STAMPED: "std_msgs/Header header\ngeometry_msgs/Twist twist",
    ODOMETRY: "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
    "diagnostic_msgs/msg/DiagnosticStatus": "byte level\nstring name\nstring message\nstring hardware_id\n"
    "diagnostic_msgs/KeyValue[] values",
    DIAGNOSTICS: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
    "std_msgs/msg/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/msg/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/msg/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/msg/Marker": "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
    "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
    "std_msgs/ColorRGBA[] colors\nstring texture_resource\nsensor_msgs/CompressedImage texture\n"
    "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n"
    "visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials",
    MARKERS: "visualization_msgs/Marker[] markers",
    PX4_SETPOINT: "uint64 timestamp\nfloat32[3] position\nfloat32[3] velocity\nfloat32[3] acceleration\n"
    "float32[3] jerk\nfloat32 yaw\nfloat32 yawspeed",
    PX4_OFFBOARD: "uint64 timestamp\nbool position\nbool velocity\nbool acceleration\nbool attitude\nbool body_rate\n"
    "bool thrust_and_torque\nbool direct_actuator",
    PX4_ODOMETRY: "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\nfloat32[3] position\nfloat32[4] q\n"
    "uint8 velocity_frame\nfloat32[3] velocity\nfloat32[3] angular_velocity\nfloat32[3] position_variance\n"
    "float32[3] orientation_variance\nfloat32[3] velocity_variance\nuint8 reset_counter\nint8 quality",
    # The beginning that it has had in all releases since 1.14; what follows differs between them, and is not read.
    PX4_CONTROL_MODE: "uint64 timestamp\nbool flag_armed\nbool flag_multicopter_position_control_enabled\n"
    "bool flag_control_manual_enabled\nbool flag_control_auto_enabled\nbool flag_control_offboard_enabled",
}
"""The fields of each type, by its name in ROS 2."""

ROS1 = {**DEFINITIONS, HEADER: f"uint32 seq\n{DEFINITIONS[HEADER]}"}
"""The same for ROS 1, whose header begins with a number."""
