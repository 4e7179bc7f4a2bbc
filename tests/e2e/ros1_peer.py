"""A ROS 1 node of Debian's own packages, for test_ros1.py: publishes what it is told, prints what it hears.

Started with the system's Python. Every line of standard input is a message to publish; every line of standard output
is a message that came.
"""

import json
import sys
import threading

import genpy.dynamic
import genpy.message
import roslib.message
import rospy

HEARD = {
    "/robot/prediction": None,  # kinecast_msgs and moveit_msgs are not Debian's: by the definition that is sent along
    "/robot/planning_scene": None,
    "/robot/markers": "visualization_msgs/MarkerArray",
    "/robot/person_anna/poses": "geometry_msgs/PoseArray",
    "/robot/person_anna/left_wrist": "geometry_msgs/PoseWithCovarianceStamped",
}
TOLD = {
    "/skeletons": "geometry_msgs/PoseArray",
    "/spheres": "visualization_msgs/MarkerArray",
    "/tf": "tf2_msgs/TFMessage",
    "/angles": "sensor_msgs/JointState",
}

lock = threading.Lock()
classes = {}


def plain(value):
    if isinstance(value, genpy.message.Message):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, genpy.rostime.TVal):
        return value.to_sec()
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    return value


def say(line):
    with lock:
        print(json.dumps(line), flush=True)


def heard(message, topic):
    if isinstance(message, rospy.AnyMsg):
        header = message._connection_header
        with lock:  # genpy makes one class at a time
            if topic not in classes:
                name = header["type"]
                classes[topic] = genpy.dynamic.generate_dynamic(name, header["message_definition"])[name]
                assert classes[topic]._md5sum == header["md5sum"]
        message = classes[topic]().deserialize(message._buff)
    say({"topic": topic, "type": message._type, "md5": message._md5sum, "message": plain(message)})


def main():
    rospy.init_node("peer", anonymous=True)
    publishers = {
        topic: rospy.Publisher(topic, roslib.message.get_message_class(type_), queue_size=10, tcp_nodelay=True)
        for topic, type_ in TOLD.items()
    }
    for topic, type_ in HEARD.items():
        class_ = rospy.AnyMsg if type_ is None else roslib.message.get_message_class(type_)
        rospy.Subscriber(topic, class_, heard, topic, tcp_nodelay=True)
    say("ready")
    for line in sys.stdin:
        order = json.loads(line)
        publisher = publishers[order["topic"]]
        message = publisher.data_class()
        genpy.message.fill_message_args(message, [order["message"]])
        publisher.publish(message)
    rospy.signal_shutdown("told to")


main()
