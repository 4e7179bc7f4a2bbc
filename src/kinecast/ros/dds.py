"""ROS 2's topics on the wire by CycloneDDS, without any ROS installed: its names, types, CDR and qualities of service.

Source: https://design.ros2.org/articles/topic_and_service_names.html. `/skeletons` is the DDS topic `rt/skeletons`, and
`geometry_msgs/msg/PoseArray` the type `geometry_msgs::msg::dds_::PoseArray_`.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from msgspec import Meta
from rosbags.interfaces import Nodetype
from rosbags.typesys.msg import normalize_msgtype

from kinecast.errors import OptionError
from kinecast.ros.messages import Distribution, Messages, messages_of
from kinecast.ros.publisher import OutputOptions
from kinecast.ros.subscriber import InputOptions
from kinecast.ros.transport import CLOSING, Callback, Transport

MOST_AT_ONCE = 64
LOOK = 0.2  # longest wait for a message before looking whether to end [s]
LOOPBACK = "127.0.0.1"
PARTICIPANTS = 32  # others on this machine that are looked for without multicast

_CDR = Policy.DataRepresentation(use_cdrv0_representation=True)
_RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=100))
# As rclcpp's default, in plain CDR; its sensor data, which matches every publisher; all that /tf_static said before.
WRITER = Qos(_RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10), _CDR)
READER = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(100), _CDR)
STATIC_READER = Qos(_RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(100), _CDR)

_domains: dict[int, tuple[str, Domain]] = {}  # of this process, each with its network


@dataclass(frozen=True)
class DdsOptions:
    """Where ROS 2 is, and which."""

    distro: Literal["humble", "jazzy"] = "jazzy"  # whose definitions are spoken
    domain: str = ""  # a number; "" for ROS_DOMAIN_ID
    network: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.:-]*\Z", description="the name or address of an interface")] = (
        ""
    )
    """"" is this machine alone, unless CYCLONEDDS_URI says otherwise."""


@dataclass(frozen=True)
class DdsInputOptions(DdsOptions, InputOptions):
    """Of a source."""


@dataclass(frozen=True)
class DdsOutputOptions(DdsOptions, OutputOptions):
    """Of a sink."""


class DdsTransport(Transport):
    """A participant of a DDS domain; see `participant`."""

    def __init__(self, options: DdsOptions) -> None:
        super().__init__(messages_of(Distribution(options.distro)))
        self._participant = participant(options.domain or os.environ.get("ROS_DOMAIN_ID", "0"), options.network)
        self._readers: list[tuple[DataReader[Any], str, Callback]] = []
        self._waiting = WaitSet(self._participant)
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        qos = STATIC_READER if topic == "/tf_static" else READER
        reader = DataReader(self._participant, self._topic(topic, type_), qos=qos)
        self._waiting.attach(ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any))
        self._readers.append((reader, topic, callback))
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, name="dds", daemon=True)
            self._thread.start()

    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        sent = self._topic(topic, type_)
        writer = DataWriter(self._participant, sent, qos=WRITER)

        def publish(content: bytes) -> None:
            try:
                writer.write(sent.data_type(content))
            except DDSException as error:
                raise OSError(str(error)) from None

        return publish

    def close(self) -> None:
        self._ended.set()
        if self._thread:
            self._thread.join(CLOSING)
        self._readers.clear()
        self._publishers.clear()

    def _read(self) -> None:
        while not self._ended.is_set():
            self._waiting.wait(duration(seconds=LOOK))
            for reader, topic, callback in self._readers:
                for sample in reader.take(MOST_AT_ONCE):
                    if sample.sample_info.valid_data and not self._ended.is_set():
                        callback(topic, sample.content)

    def _topic(self, topic: str, type_: str) -> Topic[Any]:
        """One whose messages are no more than their bytes."""

        def initialise(self: Any, content: bytes = b"") -> None:
            self.content = content

        struct = idl_type(self.messages, type_, {})
        struct.__init__ = initialise
        struct.serialize = lambda self, *_, **__: self.content
        struct.deserialize = struct.deserialize_key = classmethod(lambda class_, data, *_, **__: class_(bytes(data)))
        return Topic(self._participant, f"rt{topic}", struct)


def participant(number: str, network: str) -> DomainParticipant:
    """A participant of a domain, a number as ROS_DOMAIN_ID, on an interface, as in `DdsOptions`.

    An OptionError for a domain or an interface that is none, or not the one this process uses already.
    """
    if not (number.isascii() and number.isdecimal() and int(number) <= 232):
        raise OptionError(f"domain {number} is outside 0..232")
    domain = int(number)
    try:
        if domain not in _domains:
            _domains[domain] = network, Domain(domain, _configuration(network))
        if _domains[domain][0] != network:
            raise OptionError(f"network {network!r}: this process uses {_domains[domain][0]!r} for domain {domain}")
        return DomainParticipant(domain)
    except DDSException as error:
        raise OptionError(f"DDS: domain {domain} cannot be opened on {network or LOOPBACK} ({error})") from None


def _configuration(network: str) -> str | None:
    """CycloneDDS's XML; None where the environment has it."""
    if not network and "CYCLONEDDS_URI" in os.environ:
        return None
    if network:
        kind = "address" if re.fullmatch(r"[0-9.]+|[0-9a-fA-F:]+:[0-9a-fA-F:]*", network) else "name"
        settings = f'<General><Interfaces><NetworkInterface {kind}="{network}"/></Interfaces></General>'
    else:
        settings = f"""<General>
          <Interfaces><NetworkInterface address="{LOOPBACK}"/></Interfaces><AllowMulticast>false</AllowMulticast>
        </General><Discovery>
          <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{PARTICIPANTS}</MaxAutoParticipantIndex>
          <Peers><Peer address="{LOOPBACK}"/></Peers></Discovery>"""
    return f"<CycloneDDS><Domain>{settings}</Domain></CycloneDDS>"


def idl_type(messages: Messages, type_: str, known: dict[str, Any]) -> Any:
    """CycloneDDS's type of a message; it and those it is made of are added to the known ones."""

    def of(node: Nodetype, kind: Any) -> Any:
        if node == Nodetype.NAME:
            return idl_type(messages, kind, known)
        if node == Nodetype.BASE:
            plain = {"string": str, "bool": bool, "byte": types.uint8, "char": types.uint8}
            return plain.get(kind[0]) or getattr(types, kind[0])
        part, length = kind
        kinds: Any = types
        return kinds.array[of(*part), length] if node == Nodetype.ARRAY else kinds.sequence[of(*part)]

    name = normalize_msgtype(type_)
    if name not in known:
        package, _, bare = name.split("/")
        fields = {field: of(*kind) for field, kind in messages.store.fielddefs[name][1]}
        known[name] = make_idl_struct(bare, f"{package}.msg.dds_.{bare}_", fields)
    return known[name]
