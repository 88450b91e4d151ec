"""A ROS 2 node that drives a robot by `spikedeploy serve`; it needs rclpy and pyzmq.

    spikedeploy serve hexapod/sparse --chip loihi1
    python examples/ros2_node.py --ros-args -p endpoint:=tcp://127.0.0.1:5555 -p rate:=50.0

It takes the latest message of `observation` in each period, and publishes its action on `action`.
An answer that comes too late is not waited for: the robot gets no action, and the node says so,
connects again and begins a new episode.
The numbers and units of an observation are those that the policy was trained on.
"""

import json

import rclpy
import zmq
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray


class SpikingPolicy(Node):
    """Observation in, action out, in each period."""

    def __init__(self) -> None:
        super().__init__("spiking_policy")
        self.declare_parameter("endpoint", "tcp://127.0.0.1:5555")
        self.declare_parameter("rate", 50.0)
        self._late = round(1000 / self.get_parameter("rate").value)  # [ms]
        self._observation = None
        if not self._begun():
            raise RuntimeError("no episode: is `spikedeploy serve` running, with a free place?")
        self.create_subscription(Float64MultiArray, "observation", self._observed, 1)
        self._actions = self.create_publisher(Float64MultiArray, "action", 1)
        self.create_timer(1 / self.get_parameter("rate").value, self._act)

    def _begun(self) -> bool:
        """Whether an episode began, over a new socket: one that lost a reply is of no use."""
        self._socket = zmq.Context.instance().socket(zmq.REQ)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.connect(self.get_parameter("endpoint").value)
        reply = self._ask({"do": "reset", "seed": 0}, wait=2000)
        begun = reply is not None and reply["ok"]
        if not begun:
            self._socket.close()
        return begun

    def _ask(self, request: dict, wait: int) -> dict | None:
        """Return the reply; None where none came in so many milliseconds."""
        if not self._socket.poll(wait, zmq.POLLOUT):
            return None
        self._socket.send(json.dumps(request).encode())
        return json.loads(self._socket.recv()) if self._socket.poll(wait) else None

    def _observed(self, message: Float64MultiArray) -> None:
        self._observation = list(message.data)

    def _act(self) -> None:
        if self._observation is None:
            return
        if self._socket.closed and not self._begun():
            return
        reply = self._ask({"do": "act", "observation": self._observation}, self._late)
        if reply is None:
            self.get_logger().warning("no action in time; connecting again")
            self._socket.close()
        elif reply["ok"]:
            self._actions.publish(Float64MultiArray(data=reply["action"]))
        else:
            self.get_logger().error(reply["error"])
            if "send reset" in reply["error"]:
                self._socket.close()


def main() -> None:
    """Run until Ctrl-C."""
    rclpy.init()
    rclpy.spin(SpikingPolicy())


if __name__ == "__main__":
    main()
