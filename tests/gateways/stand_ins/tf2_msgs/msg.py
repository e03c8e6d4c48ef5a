from __future__ import annotations

from dataclasses import dataclass, field

from geometry_msgs.msg import TransformStamped


@dataclass
class TFMessage:
    transforms: list[TransformStamped] = field(default_factory=list)
