"""ROS 2's topics on the wire by CycloneDDS, without any ROS installed: its names, types, CDR and qualities of service.

Source: https://design.ros2.org/articles/topic_and_service_names.html. `/skeletons` is the DDS topic `rt/skeletons`, and
`geometry_msgs/msg/PoseArray` the type `geometry_msgs::msg::dds_::PoseArray_`.
"""

from __future__ import annotations

import os
import re
import threading
import time
from typing import Any

from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.interfaces import Nodetype
from rosbags.typesys.msg import normalize_msgtype

from kinecast.errors import OptionError
from kinecast.ros.carrier import Taker
from kinecast.ros.messages import Distribution, Messages, messages_of

__all__ = ["DdsCarrier", "idl_type", "participant", "reader_qos", "topic_name", "writer_qos"]

MOST_AT_ONCE = 64
LOOK = 0.2
"""Longest wait for a message before looking whether to end [s]."""
LOOPBACK = "127.0.0.1"
PARTICIPANTS = 32
"""Others on this machine that are looked for without multicast."""

_domains: dict[int, tuple[str, Domain]] = {}
_lock = threading.Lock()


class DdsCarrier:
    """A participant of a DDS domain.

    Args:
        distribution: whose definitions are spoken, Humble's or Jazzy's.
        domain: as ROS_DOMAIN_ID.
        network: interface, by name or address; "" is this machine alone, unless CYCLONEDDS_URI says otherwise.

    Raises:
        OptionError: an interface that is none, or not the one this process uses already.
    """

    def __init__(self, distribution: Distribution, domain: int, network: str = "") -> None:
        self.messages = messages_of(distribution)
        self._participant = participant(domain, network)
        self._writers: dict[str, DataWriter[Any]] = {}
        self._readers: list[tuple[DataReader[Any], str, Taker]] = []
        self._waiting = WaitSet(self._participant)
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._classes: dict[str, type] = {}

    def subscribe(self, topic: str, type_: str, take: Taker) -> None:
        """See Carrier."""
        reader = DataReader(self._participant, self._topic(topic, type_), qos=reader_qos(topic))
        state = SampleState.Any | ViewState.Any | InstanceState.Any
        self._waiting.attach(ReadCondition(reader, state))
        self._readers.append((reader, topic, take))
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, name="dds", daemon=True)
            self._thread.start()

    def advertise(self, topic: str, type_: str) -> None:
        """See Carrier."""
        if topic not in self._writers:
            self._writers[topic] = DataWriter(self._participant, self._topic(topic, type_), qos=writer_qos())

    def publish(self, topic: str, type_: str, content: bytes) -> None:
        """See Carrier."""
        self.advertise(topic, type_)
        try:
            self._writers[topic].write(self._class(type_)(content))
        except DDSException as error:
            raise OSError(str(error)) from None

    def now(self) -> float:
        """See Carrier: the time of this machine."""
        return time.time()

    def close(self) -> None:
        """See Carrier."""
        self._ended.set()
        if self._thread:
            self._thread.join()
        self._readers.clear()
        self._writers.clear()

    def _read(self) -> None:
        while not self._ended.is_set():
            self._waiting.wait(duration(seconds=LOOK))
            for reader, topic, take in self._readers:
                for sample in reader.take(MOST_AT_ONCE):
                    if sample.sample_info.valid_data and not self._ended.is_set():
                        take(topic, sample.content)

    def _topic(self, topic: str, type_: str) -> Topic[Any]:
        return Topic(self._participant, topic_name(topic), self._class(type_))

    def _class(self, type_: str) -> type:
        if type_ not in self._classes:
            self._classes[type_] = _bytes_class(self.messages, type_)
        return self._classes[type_]


def _bytes_class(messages: Messages, type_: str) -> Any:
    """The type of a message, whose objects are no more than its bytes."""

    def initialise(self: Any, content: bytes = b"") -> None:
        self.content = content

    struct = idl_type(messages, type_, {})
    struct.__init__ = initialise
    struct.serialize = lambda self, *_, **__: self.content
    struct.deserialize = struct.deserialize_key = classmethod(lambda class_, data, *_, **__: class_(bytes(data)))
    return struct


def topic_name(topic: str) -> str:
    """The DDS topic of a ROS topic."""
    return f"rt{topic}"


def writer_qos() -> Qos:
    """As rclcpp's default: reliable, volatile, keeps the last 10; plain CDR."""
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def reader_qos(topic: str) -> Qos:
    """As rclcpp's sensor data, which matches every publisher; of /tf_static whatever was said before is wanted too."""
    fixed = topic == "/tf_static"
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)) if fixed else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if fixed else Policy.Durability.Volatile,
        Policy.History.KeepLast(100),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def participant(domain: int, network: str) -> DomainParticipant:
    """A participant on an interface; see DdsCarrier.

    Raises:
        OptionError: see there.
    """
    if not 0 <= domain <= 232:
        raise OptionError(f"domain {domain} is outside 0..232")
    if not re.fullmatch(r"[A-Za-z0-9_.:-]*", network):
        raise OptionError(f"network {network!r} is no interface")
    with _lock:
        if domain not in _domains:
            try:
                _domains[domain] = network, Domain(domain, _configuration(network))
            except DDSException as error:
                raise OptionError(f"DDS: domain {domain} cannot be opened on {network or LOOPBACK} ({error})") from None
        if _domains[domain][0] != network:
            raise OptionError(f"network {network!r}: this process uses {_domains[domain][0]!r} for domain {domain}")
        try:
            return DomainParticipant(domain)
        except DDSException as error:
            raise OptionError(f"DDS: domain {domain} cannot be joined on {network or LOOPBACK} ({error})") from None


def _configuration(network: str) -> str | None:
    """CycloneDDS's XML; None where the environment has it."""
    if network:
        kind = "address" if re.fullmatch(r"[0-9.]+|[0-9a-fA-F:]+:[0-9a-fA-F:]*", network) else "name"
        interface = f'<NetworkInterface {kind}="{network}"/>'
        return f"<CycloneDDS><Domain><General><Interfaces>{interface}</Interfaces></General></Domain></CycloneDDS>"
    if "CYCLONEDDS_URI" in os.environ:
        return None
    return f"""<CycloneDDS><Domain>
        <General>
          <Interfaces><NetworkInterface address="{LOOPBACK}"/></Interfaces><AllowMulticast>false</AllowMulticast>
        </General>
        <Discovery>
          <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{PARTICIPANTS}</MaxAutoParticipantIndex>
          <Peers><Peer address="{LOOPBACK}"/></Peers>
        </Discovery>
      </Domain></CycloneDDS>"""


def idl_type(messages: Messages, type_: str, known: dict[str, Any]) -> Any:
    """CycloneDDS's type of a message.

    Args:
        messages: whose definitions are used.
        type_: `package/Type`.
        known: types made before; this one and those it is made of are added.
    """
    name = normalize_msgtype(type_)
    if name not in known:
        package, _, bare = name.split("/")
        fields = {field: _field(messages, known, *kind) for field, kind in messages.store.fielddefs[name][1]}
        known[name] = make_idl_struct(bare, f"{package}.msg.dds_.{bare}_", fields)
    return known[name]


def _field(messages: Messages, known: dict[str, Any], node: Nodetype, kind: Any) -> Any:
    if node == Nodetype.NAME:
        return idl_type(messages, kind, known)
    if node == Nodetype.BASE:
        return _PLAIN[kind[0]]
    part, length = kind
    of = _field(messages, known, *part)
    kinds: Any = types
    return kinds.array[of, length] if node == Nodetype.ARRAY else kinds.sequence[of]


_PLAIN: dict[str, Any] = {"string": str, "bool": bool, "byte": types.uint8, "char": types.uint8} | {
    name: getattr(types, name)
    for name in ("float32", "float64", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
}
