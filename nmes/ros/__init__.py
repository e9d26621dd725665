"""A door for programs that are written for ROS: the rosbridge protocol, version 2, over WebSockets.

`rosbridge_application` makes the application that a `Host` serves; see docs/ros.md for what it offers.
"""

from nmes.ros.bridge import rosbridge_application

__all__ = ["rosbridge_application"]
