"""A robot's controller as one writes it with roslibpy: it knows nothing of what is at the other end.

`controller.py PORT GENOME` spawns a creature, has its joint follow a wave, and prints what it saw.
"""

import json
import math
import sys
import threading
from typing import Any

from roslibpy import Param, Ros, Service, ServiceRequest, Topic

ros = Ros("127.0.0.1", int(sys.argv[1]))
ros.run(timeout=20)
pose = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}}
request = {"model_name": "rocker", "model_xml": sys.argv[2], "initial_pose": pose}
spawned = Service(ros, "/spawn", "gazebo_msgs/SpawnModel").call(ServiceRequest(request), timeout=20)
motor = Topic(ros, "/rocker/joint_command", "sensor_msgs/JointState")
motor.advertise()
seen: list[dict[str, Any]] = []
over = threading.Event()


def follow(message: dict[str, Any]) -> None:
    seen.append(message)
    time = message["header"]["stamp"]["secs"] + 1e-9 * message["header"]["stamp"]["nsecs"]
    motor.publish({"name": ["shoulder"], "position": [0.4 * math.sin(3 * time)]})
    positions = [each["position"][0] for each in seen]
    if len(seen) >= 100 and max(positions) > 0.3 and min(positions) < -0.2:  # on a busy machine it follows later
        over.set()


states = Topic(ros, "/rocker/joint_states", "sensor_msgs/JointState")
states.subscribe(follow)
over.wait(30)
states.unsubscribe()
look = {
    "spawned": dict(spawned),
    "topics": ros.get_topics(),
    "types": [ros.get_topic_type(topic) for topic in ("/tf", "/rocker/torso/pose")],
    "nodes": ros.get_nodes(),
    "time": ros.get_time()["secs"],
    "parameters": ros.get_params(),
    "fields": ros.get_message_details("sensor_msgs/JointState")["typedefs"][0]["fieldnames"],
    "takes": ros.get_service_request_details("gazebo_msgs/SpawnModel")["typedefs"][0]["fieldnames"],
    "answers": ros.get_service_response_details("gazebo_msgs/SpawnModel")["typedefs"][0]["fieldnames"],
    "of_type": ros.get_topics_for_type("sensor_msgs/JointState"),
    "service": [ros.get_service_type("/reset"), ros.get_services_for_type("gazebo_msgs/SpawnModel")],
    "node": ros.get_node_details("/nmes")["publishing"][:2],
    "simulated": Param(ros, "/use_sim_time").get(),
    "positions": [message["position"][0] for message in seen],
}
Service(ros, "/reset", "std_srvs/Empty").call(ServiceRequest({}), timeout=20)
print(json.dumps({**look, "after": ros.get_topics()}))
ros.terminate()
