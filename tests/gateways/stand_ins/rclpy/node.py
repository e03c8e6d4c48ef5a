from __future__ import annotations

import time
from typing import Any, Callable

from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile

overrides: dict[str, Any] = {}  # what a parameter file would say


class Parameter:
    def __init__(self, value: Any) -> None:
        self.value = value


class Logger:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, text: str, **_: Any) -> None:
        self.lines.append(text)

    warning = error = info


class Publisher:
    def __init__(self) -> None:
        self.published: list[Any] = []

    def publish(self, message: Any) -> None:
        self.published.append(message)


class Now:
    def to_msg(self) -> Time:
        return Time(sec=int(time.time()))


class Clock:
    def now(self) -> Now:
        return Now()


class Node:
    def __init__(self, name: str) -> None:
        self.name = name
        self.subscribed: dict[str, tuple[type, Callable[[Any], None], QoSProfile]] = {}
        self.publishers: dict[str, Publisher] = {}
        self.timers: list[Callable[[], None]] = []
        self._logger = Logger()

    def declare_parameter(self, name: str, default: Any) -> Parameter:
        return Parameter(overrides.get(name, default))

    def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        self.subscribed[topic] = (kind, callback, qos)

    def create_publisher(self, kind: type, topic: str, qos: QoSProfile | int) -> Publisher:
        return self.publishers.setdefault(topic, Publisher())

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        self.timers.append(callback)

    def get_logger(self) -> Logger:
        return self._logger

    def get_clock(self) -> Clock:
        return Clock()

    def destroy_node(self) -> None: ...
