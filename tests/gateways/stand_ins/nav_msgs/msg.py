from __future__ import annotations

from dataclasses import dataclass, field

from geometry_msgs.msg import PoseWithCovariance
from std_msgs.msg import Header


@dataclass
class Odometry:
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
