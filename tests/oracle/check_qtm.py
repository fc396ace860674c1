"""Talks to `mocapd-sim serve --protocol qtm`, and to the service with `[publish.qtm]`, with clients that are not ours:
Qualisys's own for Python, qtm-rt, and for Node.js, npm's qualisys-rt; the crate qualisys; and motioncapture, which reads rigid bodies
with the C++ SDK.

    npm ci --prefix FOLDER                      # with package.json and package-lock.json of tests/oracle/npm in FOLDER
    cargo build -p mocapd-drivers --example qtm_client
    python check_qtm.py --mocapd-sim target/release/mocapd-sim --mocapd target/release/mocapd [--npm FOLDER] \\
        [--crate-client target/debug/examples/qtm_client] [--seconds 60]

Clients of npm and the crate that are not named are not run. qtm-rt has no streams over UDP: they are requested through its
connection, and its own parser reads the datagrams.
With --memory it measures instead what eight clients at 200 markers and 1000 Hz add to the memory of the service.
One line a check; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import asyncio
import concurrent.futures
import contextlib
import csv
import functools
import itertools
import json
import math
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import qtm_rt
from in_child import in_child
from qtm_rt.discovery import QRTDiscoveryProtocol
from qtm_rt.packet import QRTComponentType, QRTEvent, QRTPacket

RATE_HZ = 240
N_FRAMES = 480
N_LABELLED = 64
LABELS = tuple(f"marker {k:02} <&>" for k in range(N_LABELLED))
# Names of unlabelled markers in a table; they are sent with ids.
UNLABELLED = (f"u{N_LABELLED + 1:03}", f"u{N_LABELLED + 2:03}")
FIRST_ID = 1000
RESIDUAL_MM = 0.25
COLUMNS = N_LABELLED + len(UNLABELLED)

# It names its port as soon as it has opened it; a machine under load may take seconds to start it.
FIRST_WORD_WITHIN_S = 30.0


def float32(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


@functools.cache
def position(column, frame):
    """Where a marker is, exactly as float32 has it; None while it is hidden."""
    if (column == 1 and 100 <= frame < 150) or (column == N_LABELLED and 50 <= frame < 120):
        return None
    return tuple(float32(v) for v in (10.1 * column + 0.5 * frame, -20.7 * column + 0.25 * frame, 1000.3 + 5.0 * column))


def write_motion(path):
    names = [f"{label}.{axis}" for label in LABELS + UNLABELLED for axis in "xyz"]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "time_s", *names])
        for frame in range(N_FRAMES):
            cells = [frame, f"{frame / RATE_HZ:.9f}"]
            for column in range(COLUMNS):
                cells += [repr(v) for v in position(column, frame) or ()] or ["", "", ""]
            writer.writerow(cells)


@contextlib.contextmanager
def simulator(program, motion, *more):
    """A simulated QTM in a process of its own: its port."""
    command = [program, "serve", *motion, "--tcp", "--protocol", "qtm", *more]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE,
                               stderr=subprocess.DEVNULL, text=True)
    silent = threading.Timer(FIRST_WORD_WITHIN_S, process.kill)
    silent.start()
    try:
        uri = process.stdout.readline().strip()
        silent.cancel()
        expect(uri.startswith("qtm:127.0.0.1:"), f"the simulator names no port: {uri!r}")
        yield int(uri.rpartition(":")[2])
    finally:
        silent.cancel()
        process.terminate()
        process.wait(10)


def expect(holds, complaint):
    if not holds:
        raise AssertionError(complaint)


async def connected(port, **more):
    connection = await qtm_rt.connect("127.0.0.1", port, **more)
    expect(connection is not None, "qtm-rt cannot connect")
    return connection


def same(got, expected):
    """Equal floats, and NaN for a marker that is hidden."""
    if expected is None:
        return all(math.isnan(value) for value in got)
    return tuple(got) == expected


def check_labelled(markers, number):
    expect(len(markers) == N_LABELLED, f"frame {number}: {len(markers)} labelled markers")
    for column, marker in enumerate(markers):
        expected = position(column, number % N_FRAMES)
        # Not by `expect`, which would write a message for each of a million markers.
        if not same(marker[:3], expected) or len(marker) > 3 and marker.residual != RESIDUAL_MM:
            raise AssertionError(f"frame {number} marker {column}: {marker}, not {expected}")


def check_unlabelled(markers, number):
    seen = {column: position(column, number % N_FRAMES) for column in range(N_LABELLED, COLUMNS)}
    expected = {FIRST_ID + column: place for column, place in seen.items() if place is not None}
    got = {marker.id: tuple(marker[:3]) for marker in markers}
    expect(got == expected, f"frame {number}: {got}, not {expected}")


def check_packet(packet):
    """A frame with all four components; returns its number."""
    number = packet.framenumber
    for header, markers in (packet.get_3d_markers(), packet.get_3d_markers_residual()):
        expect(header.marker_count == N_LABELLED, header)
        check_labelled(markers, number)
    for header, markers in (packet.get_3d_markers_no_label(), packet.get_3d_markers_no_label_residual()):
        expect((header.drop_rate, header.out_of_sync_rate) == (0, 0), header)
        check_unlabelled(markers, number)
    return number


ALL = ["3d", "3dres", "3dnolabels", "3dnolabelsres"]


async def streamed(port, frames, seconds):
    """The numbers and times of the frames that arrive, all of them checked."""
    connection, numbers, times, problems = await connected(port), [], [], []

    def on_packet(packet):
        try:
            numbers.append(check_packet(packet))
            times.append(packet.timestamp)
        except AssertionError as problem:
            problems.append(problem)

    expect(await connection.stream_frames(frames, ALL, on_packet) == b"Ok", "no stream")
    await asyncio.sleep(seconds)
    await connection.stream_frames_stop()
    connection.disconnect()
    if problems:
        raise problems[0]
    return numbers, times


async def check_stream(port, options):
    numbers, times = await streamed(port, "allframes", options.seconds)
    expect(len(numbers) > 0.9 * RATE_HZ * options.seconds, f"{len(numbers)} frames")
    expect(numbers == list(range(numbers[0], numbers[0] + len(numbers))), "frames are missing")
    steps = {later - earlier for earlier, later in zip(times, times[1:])}
    expect(steps <= {4166, 4167}, f"steps of {steps} us")


async def check_divisor(port, _):
    numbers, _ = await streamed(port, "frequencydivisor:4", 1.5)
    expect(len(numbers) > 60, f"{len(numbers)} frames")
    expect({b - a for a, b in zip(numbers, numbers[1:])} == {4}, numbers)


async def check_frequency(port, _):
    numbers, _ = await streamed(port, "frequency:100", 1.5)
    steps = [b - a for a, b in zip(numbers, numbers[1:])]
    expect(set(steps) == {2, 3}, steps)
    rate_hz = RATE_HZ * len(steps) / sum(steps)
    expect(abs(rate_hz - 100) < 2, f"{rate_hz} Hz")


async def check_identity(port, _):
    connection = await connected(port)
    version = await connection.qtm_version()
    expect(version.startswith(b"QTM Version is mocapd-sim"), version)
    expect(await connection.byte_order() == b"Byte order is little endian", "the byte order")
    expect(await connection.get_state() == QRTEvent.EventRTfromFileStopped, "the state")
    connection.disconnect()
    for version in ("1.8", "1.20", "1.28"):
        (await connected(port, version=version)).disconnect()
    for version in ("1.7", "1.29", "2.0"):
        expect(await qtm_rt.connect("127.0.0.1", port, version=version) is None, f"version {version}")


async def check_settings(port, _):
    connection = await connected(port)
    root = ET.fromstring(await connection.get_parameters(["3d"]))
    expect(root.tag == "QTM_Parameters_Ver_1.25", root.tag)
    markers = root.find("The_3D")
    expect(markers.findtext("Labels") == str(N_LABELLED), "the number of labels")
    expect([label.findtext("Name") for label in markers.iter("Label")] == list(LABELS), "the labels")
    expect(markers.findtext("AxisUpwards") == "+Z", "the axis")
    general = ET.fromstring(await connection.get_parameters(["general"])).find("General")
    expect(general.findtext("Frequency") == str(RATE_HZ), "the rate")
    everything = ET.fromstring(await connection.get_parameters(["all"]))
    expect([child.tag for child in everything] == ["General", "The_3D"], "all settings")
    for missing in ("6d", "force", "analog"):
        try:
            await connection.get_parameters([missing])
            expect(False, f"{missing} is there")
        except qtm_rt.QRTCommandException as problem:
            expect("Parameters not available" in str(problem), problem)
    connection.disconnect()


async def check_one_frame(port, _):
    connection = await connected(port)
    for _ in range(20):
        check_packet(await connection.get_current_frame(ALL))
    packet = await connection.get_current_frame(["3dnolabels", "analog", "6d"])
    expect(list(packet.components) == [QRTComponentType.Component3dNoLabels], packet.components)
    connection.disconnect()


def read_datagrams(receiver, datagrams):
    """Keeps up with any stream: the datagrams are checked afterwards."""
    with contextlib.suppress(OSError):
        while True:
            datagrams.append(receiver.recv(65536))


async def check_datagrams(port, options):
    connection = await connected(port)
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(2)
    datagrams = []
    reader = threading.Thread(target=read_datagrams, args=(receiver, datagrams))
    reader.start()
    command = f"streamframes allframes udp:{receiver.getsockname()[1]} {' '.join(ALL)}"
    await connection._protocol.send_command(command, callback=False)
    await asyncio.sleep(options.seconds)
    await connection.stream_frames_stop()
    reader.join()
    numbers = []
    for datagram in datagrams:
        size, kind = struct.unpack_from("<II", datagram)
        expect((size, kind) == (len(datagram), 3), f"a datagram of {len(datagram)} bytes: {size}, {kind}")
        numbers.append(check_packet(QRTPacket(datagram[8:])))
    expect(len(numbers) > 0.9 * RATE_HZ * options.seconds, f"{len(numbers)} frames")
    expect(numbers == list(range(numbers[0], numbers[0] + len(numbers))), "frames are missing")
    for refused in ("udp:1022", "udp:192.0.2.1:5000"):
        try:
            await connection._protocol.send_command(f"streamframes allframes {refused} 3d")
            expect(False, f"{refused} is accepted")
        except qtm_rt.QRTCommandException as problem:
            expect("Parse error" in str(problem), problem)
    connection.disconnect()
    receiver.close()


async def refused(awaitable, reason):
    try:
        answer = await awaitable
    except qtm_rt.QRTCommandException as problem:
        expect(reason in str(problem), f"{problem}, not {reason}")
        return
    expect(False, f"{answer!r}, not {reason}")


async def check_control(port, _):
    events = []
    one, other = await connected(port, on_event=events.append), await connected(port)
    await refused(one.start(rtfromfile=True), "You must be master to issue this command")
    await one.take_control("password")
    await refused(other.take_control(""), "is already master")
    await refused(one.start(), "Not connected. Create connection with new")
    await one.start(rtfromfile=True)
    await one.stop()
    await refused(one.stop(), "No measurement is running")
    await one.new()
    await one.new()
    await one.start()
    await refused(one.start(), "Measurement is already running")
    await one.set_qtm_event("a label")
    await refused(one.load("file"), "Active camera connection exists")
    await refused(one.trig(), "QTM not waiting for trig")
    await one.stop()
    await refused(one.set_qtm_event("a label"), "QTM is not capturing")
    await refused(one.save("file"), "No measurement to save")
    await one.close()
    await one.close()
    await one.release_control()
    await other.take_control("")
    await other.release_control()
    expected = [
        QRTEvent.EventRTfromFileStarted, QRTEvent.EventRTfromFileStopped, QRTEvent.EventConnected,
        QRTEvent.EventCaptureStarted, QRTEvent.EventCaptureStopped,
    ]
    expect(events == expected, events)
    for connection in (one, other):
        connection.disconnect()


async def check_samples(port, _):
    """Force plates and electrodes: settings, and every sample once."""
    connection = await connected(port)
    analog = ET.fromstring(await connection.get_parameters(["analog"])).find("Analog/Device")
    expect((analog.findtext("Channels"), analog.findtext("Frequency")) == ("5", "2000"), "the analog device")
    labels = [(channel.findtext("Label"), channel.findtext("Unit")) for channel in analog.iter("Channel")]
    expect(labels == [(f"EMG{k}", "V") for k in range(1, 6)], labels)
    plates = list(ET.fromstring(await connection.get_parameters(["force"])).iter("Plate"))
    expect([plate.findtext("Plate_ID") for plate in plates] == ["1", "2"], "the plates")
    numbers, problems, loads = {}, [], []

    def follow(key, first, count):
        if key in numbers and numbers[key] != first:
            problems.append(f"{key}: {first} after {numbers[key]}")
        numbers[key] = first + count

    def on_packet(packet):
        _, channels = packet.get_analog()
        for index, (device, (first,), channel) in enumerate(channels):
            # One entry a channel, of one device.
            if index == 0:
                follow(("analog", device.id), first, device.sample_count)
            if len(channel[0]) != device.sample_count:
                problems.append("a channel is short")
        _, forces = packet.get_force()
        for plate, values in forces:
            follow(("plate", plate.id), plate.force_number, plate.force_count)
            loads.extend(value.z for value in values)

    await connection.stream_frames("allframes", ["3d", "analog", "force"], on_packet)
    await asyncio.sleep(2)
    await connection.stream_frames_stop()
    connection.disconnect()
    expect(not problems, problems[:3])
    expect(set(numbers) == {("analog", 1), ("plate", 1), ("plate", 2)}, numbers)
    expect(numbers["analog", 1] > 3000 and numbers["plate", 1] > 1500, numbers)
    expect(max(loads) > 100, "nobody stands on the plates")


N_BODIES = 3


def turned(matrix, point):
    """A point of the body in the laboratory, by a matrix that is sent column after column."""
    return [sum(matrix[3 * column + row] * point[column] for column in range(3)) for row in range(3)]


def matrix_of_angles(roll, pitch, yaw):
    """By the QTM manual: that of the roll about x, times that of the pitch about y, times that of the yaw about z."""
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(a), math.cos(a)) for a in map(math.radians, (roll, pitch, yaw)))
    rows = [[cy * cz, -cy * sz, sy],
            [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
            [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy]]
    return [rows[row][column] for column in range(3) for row in range(3)]


def read_motioncapture(port, seconds):
    """Names and poses of the bodies in each frame that motioncapture reads; it wants the base port, one below."""
    import motioncapture

    client = motioncapture.connect("qualisys", {"hostname": "127.0.0.1", "port": str(port - 1)})
    frames, ends_at = [], time.monotonic() + seconds
    while time.monotonic() < ends_at:
        client.waitForNextFrame()
        frames.append({
            name: (tuple(float(v) for v in body.position),
                   (body.rotation.w, body.rotation.x, body.rotation.y, body.rotation.z))
            for name, body in client.rigidBodies.items()})
    return frames


async def bodies_beside_motioncapture(port, seconds):
    """qtm-rt and motioncapture read the same bodies in the same frames."""
    connection, packets = await connected(port), []
    root = ET.fromstring(await connection.get_parameters(["6d"]))
    names = [body.findtext("Name") for body in root.find("The_6D").iter("Body")]
    expect(len(names) == N_BODIES and len(set(names)) == N_BODIES, names)

    def on_packet(packet):
        packets.append((packet.framenumber, packet.get_6d_residual(), packet.get_6d_euler()))

    await connection.stream_frames("allframes", ["6dres", "6deuler"], on_packet)
    # It waits for ever for a frame that does not come.
    theirs = await asyncio.to_thread(in_child, read_motioncapture, port, seconds, within_s=seconds + 30)
    # The last frames that motioncapture has read may reach this client later.
    enough = len(packets) + RATE_HZ
    async with asyncio.timeout(10):
        while len(packets) < enough:
            await asyncio.sleep(0.1)
    await connection.stream_frames_stop()
    connection.disconnect()
    numbers = [number for number, _, _ in packets]
    expect(numbers == list(range(numbers[0], numbers[0] + len(numbers))), "frames are missing")
    for number, (_, matrices), (_, angles) in packets:
        expect(len(matrices) == len(angles) == N_BODIES, f"frame {number}: {len(matrices)} bodies")
        for (place, rotation, _), (same_place, euler) in zip(matrices, angles):
            expect(tuple(place) == tuple(same_place), f"frame {number}: {place}, {same_place}")
            for got, wanted in zip(rotation.matrix, matrix_of_angles(euler.a1, euler.a2, euler.a3)):
                expect(abs(got - wanted) < 1e-5, f"frame {number}: {rotation} {euler}")
    # It states no number: its frames are those whose bodies are at the same places.
    first = [tuple(v / 1000 for v in matrices[0][0]) for _, (_, matrices), _ in packets]
    found = []
    for bodies in theirs:
        expect(list(sorted(bodies)) == sorted(names), bodies)
        place = bodies[names[0]][0]
        index = found[-1] + 1 if found else 0
        if index >= len(first) or math.dist(first[index], place) > 1e-6:
            index = min(range(len(first)), key=lambda at: math.dist(first[at], place))
        found.append(index)
        for name, (sent, rotation, _) in zip(names, packets[index][1][1]):
            position, (w, x, y, z) = bodies[name]
            expect(all(abs(got - mm / 1000) <= 1.2e-7 * max(1, abs(mm / 1000)) for got, mm in zip(position, sent)),
                   f"{name} is at {position}, and not at {sent}")
            nose = turned(rotation.matrix, (1, 0, 0))
            image = (w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y))
            expect(all(abs(a - b) < 1e-5 for a, b in zip(nose, image)), f"{name} points to {image}, and not {nose}")
    expect(found == list(range(found[0], found[0] + len(found))), "motioncapture misses frames, or has some twice")
    expect(len(found) > 0.7 * RATE_HZ * seconds, f"{len(found)} frames")


async def check_bodies(port, options):
    await bodies_beside_motioncapture(port, options.seconds)


async def check_published_bodies(port, options):
    """The same through the service."""
    with tempfile.TemporaryDirectory() as folder, service(options, port, folder) as (published, _):
        (await connected_service(published, folder)).disconnect()
        await bodies_beside_motioncapture(published, options.seconds)


async def check_discovery(port, _):
    """Ours answers on the loopback, as the documents say."""
    asking = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    asking.bind(("0.0.0.0", 0))
    asking.settimeout(3)
    asking.sendto(struct.pack("<II", 10, 7) + struct.pack(">H", asking.getsockname()[1]), ("127.255.255.255", 22226))
    found = []
    receiver = QRTDiscoveryProtocol(receiver=found.append)
    with contextlib.suppress(TimeoutError):
        while not any(answer.port + 1 == port for answer in found):
            receiver.datagram_received(*asking.recvfrom(1024))
    asking.close()
    ours = [answer for answer in found if answer.port + 1 == port]
    expect(len(ours) == 1 and ours[0].info.startswith(b"localhost, mocapd-sim "), found)


@contextlib.contextmanager
def service(options, source, folder):
    """A service that records a QTM and publishes it: its port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    config = Path(folder) / "rig.toml"
    config.write_text(f"""[device]
uri = "qtm:127.0.0.1:{source}"
[take]
directory = "{folder}"
keep_free = "0B"
[http]
listen = ""
socket = "{folder}/rig.sock"
[publish.qtm]
enabled = true
listen = "127.0.0.1:{port}"
""")
    log = (Path(folder) / "rig.log").open("w")
    process = subprocess.Popen([str(options.mocapd), "run", "--config", str(config)], stdout=log, stderr=log)
    try:
        yield port, process.pid
    finally:
        process.terminate()
        process.wait(20)
        log.close()


async def connected_service(published, folder):
    """A connection to a service that has its device."""
    for _ in range(100):
        with contextlib.suppress(OSError, qtm_rt.QRTCommandException):
            connection = await qtm_rt.connect("127.0.0.1", published)
            if connection is not None:
                await connection.get_parameters(["3d"])
                return connection
        await asyncio.sleep(0.2)
    raise AssertionError((Path(folder) / "rig.log").read_text())


async def check_service(port, options):
    """What the service records, published: every frame that it gets, with the source's floats."""
    with tempfile.TemporaryDirectory() as folder, service(options, port, folder) as (published, _):
        connection = await connected_service(published, folder)
        root = ET.fromstring(await connection.get_parameters(["3d"]))
        expect([label.findtext("Name") for label in root.iter("Label")] == list(LABELS), "the labels")
        # The row of a frame is the number that the source gave it, counted from the first.
        numbers, problems = [], []

        def on_packet(packet):
            try:
                for header, markers in (packet.get_3d_markers(), packet.get_3d_markers_residual()):
                    expect(header.marker_count == N_LABELLED, header)
                    check_labelled(markers, packet.framenumber)
                numbers.append(packet.framenumber)
            except AssertionError as problem:
                problems.append(problem)

        await connection.stream_frames("allframes", ["3d", "3dres"], on_packet)
        start = [str(options.mocapd), "ctl", "--connect", f"unix:{folder}/rig.sock"]
        subprocess.run([*start, "start", "--name", "published"], check=True, capture_output=True)
        await asyncio.sleep(options.seconds)
        stopped = json.loads(subprocess.run([*start, "stop", "--json"], check=True, capture_output=True).stdout)
        status = json.loads(subprocess.run([*start, "status", "--json"], check=True, capture_output=True).stdout)
        await connection.stream_frames_stop()
        connection.disconnect()
        if problems:
            raise problems[0]
        expect(stopped["ledger"]["closes"] and stopped["ledger"]["recorded"] > 0.9 * RATE_HZ * options.seconds, stopped)
        missed = status["publish"][0]["clients"][0]["frames_missed"]
        expect(numbers[-1] - numbers[0] + 1 == len(numbers) + missed, f"{len(numbers)} frames, {missed} missed")


COMPONENTS = ("3D", "3DRes", "3DNoLabels", "3DNoLabelsRes")


class OtherClient:
    """A client in a process of its own. What it reads goes to a file, which is checked in the end: nothing slows it down meanwhile."""

    def __init__(self, name, command, has_ids):
        # Whether unlabelled markers have the ids of the simulator.
        self.name, self.has_ids = name, has_ids
        self.numbers, self.problems, self.labels, self.address, self.dropped = [], [], None, None, 0
        self.output, self.errors = tempfile.NamedTemporaryFile("w"), tempfile.NamedTemporaryFile("w")
        command = [str(word) for word in command]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=self.output, stderr=self.errors)

    def read(self):
        for line in Path(self.output.name).open():
            found = json.loads(line)
            match found["kind"]:
                case "frame":
                    self.numbers.append(found["number"])
                    try:
                        self.check_frame(found["number"], found["components"])
                    except AssertionError as problem:
                        self.problems.append(problem)
                case "settings" if "xml" in found:
                    self.labels = [label.findtext("Name") for label in ET.fromstring(found["xml"]).iter("Label")]
                case "settings":
                    self.labels = [label["name"] for label in found["settings"]["the3d"]["labels"]]
                case "address":
                    self.address = found["address"]

    def check_frame(self, number, found):
        expect(sorted(found) == sorted(COMPONENTS), f"frame {number} has {list(found)}")
        rows = [position(column, number % N_FRAMES) for column in range(COLUMNS)]
        labelled = [list(row or (None,) * 3) for row in rows[:N_LABELLED]]
        expect(found["3D"] == labelled, f"frame {number}: {found['3D'][:3]}, not {labelled[:3]}")
        expect([marker[:3] for marker in found["3DRes"]] == labelled, f"frame {number} with residuals")
        residuals = {marker[3] for marker, at in zip(found["3DRes"], labelled) if at[0] is not None}
        expect(residuals == {RESIDUAL_MM}, f"frame {number}: residuals {residuals}")
        seen = {FIRST_ID + column: list(rows[column]) for column in range(N_LABELLED, COLUMNS) if rows[column] is not None}
        for name in COMPONENTS[2:]:
            markers = {marker[0]: marker[1:4] for marker in found[name]}
            expect(len(markers) == len(found[name]), f"frame {number}: one id for two markers")
            if self.has_ids:
                expect(markers == seen, f"frame {number}: {markers}, not {seen}")
            expect(sorted(markers.values()) == sorted(seen.values()), f"frame {number}: {markers}, not {seen}")

    def close(self):
        """Ends it; it must not have ended before."""
        has_ended = self.process.poll() is not None
        for line in itertools.islice(Path(self.output.name).open(), 3):
            found = json.loads(line)
            if found["kind"] == "datagrams":
                self.dropped = dropped_datagrams(found["port"])
        self.process.stdin.close()
        self.process.wait(30)
        errors = Path(self.errors.name).read_text()
        expect(not has_ended and self.process.returncode == 0, f"{self.name}: {errors}")

    def missing(self, seconds):
        """How many frames are missing between its first and its last; labels and floats are right."""
        self.read()
        expect(not self.problems, f"{self.name}: {len(self.problems)} frames: {self.problems[:1]}")
        expect(self.labels == list(LABELS), f"{self.name}: {self.labels}")
        expect(len(self.numbers) > 0.5 * RATE_HZ * seconds, f"{self.name}: {len(self.numbers)} frames")
        expect(self.numbers == sorted(set(self.numbers)), f"{self.name}: frames come twice, or in another order")
        return self.numbers[-1] - self.numbers[0] + 1 - len(self.numbers)


def dropped_datagrams(port):
    """Datagrams that the kernel dropped because a program read its socket too slowly: nobody's fault on a machine under load."""
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        if int(fields[1].rpartition(":")[2], 16) == port:
            return int(fields[-1])
    return 0


@contextlib.contextmanager
def other_clients(options, port, has_ids):
    """All of them at once. qualisys-rt reads datagrams too slowly to keep up while it starts."""
    commands = {}
    if options.npm:
        commands["qualisys-rt"] = ["node", Path(__file__).with_name("qtm_client.cjs"), options.npm, port]
    for transport in ("tcp", "udp") if options.crate_client else ():
        commands[f"the crate qualisys by {transport}"] = [options.crate_client, port, transport]
    clients = [OtherClient(name, command, has_ids) for name, command in commands.items()]
    problems = []
    try:
        yield clients
    finally:
        for client in clients:
            try:
                client.close()
            except (AssertionError, subprocess.TimeoutExpired) as problem:
                client.process.kill()
                problems.append(problem)
    if problems:
        raise problems[0]


async def check_other_clients(port, options):
    """npm's qualisys-rt and the crate qualisys read the simulator: labels, every frame, every float."""
    with other_clients(options, port, has_ids=True) as clients:
        await asyncio.sleep(options.seconds + 1)
    for client in clients:
        missing = client.missing(options.seconds)
        expect(missing <= client.dropped, f"{client.name}: {missing} frames are missing, {client.dropped} datagrams dropped")


async def check_other_clients_of_the_service(port, options):
    """The same from the service, which says what each client missed."""
    with tempfile.TemporaryDirectory() as folder, service(options, port, folder) as (published, _):
        (await connected_service(published, folder)).disconnect()
        with other_clients(options, published, has_ids=False) as clients:
            await asyncio.sleep(options.seconds + 1)
            status = [str(options.mocapd), "ctl", "--connect", f"unix:{folder}/rig.sock", "status", "--json"]
            status = json.loads(subprocess.run(status, check=True, capture_output=True).stdout)
        missed = {client["address"]: client["frames_missed"] for client in status["publish"][0]["clients"]}
        for client in clients:
            missing = client.missing(options.seconds)
            accounted = range(missed[client.address], missed[client.address] + client.dropped + 1)
            expect(missing in accounted, f"{client.name}: {missing} frames are missing; {missed}, {client.dropped} dropped")


def resident_mb(pid):
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


async def measure_memory(port, options):
    """Eight clients, of which one does not read and one reads a byte a second."""

    async def client(published, bytes_at_once, pause_s):
        reader, writer = await asyncio.open_connection("127.0.0.1", published, limit=1 << 16)
        for command in ("Version 1.28", "StreamFrames AllFrames 3DRes 3DNoLabelsRes"):
            writer.write(struct.pack("<II", len(command) + 9, 1) + command.encode() + b"\0")
        while await reader.read(bytes_at_once):
            await asyncio.sleep(pause_s)

    with tempfile.TemporaryDirectory() as folder, service(options, port, folder) as (published, pid):
        await asyncio.sleep(15)
        before = resident_mb(pid)
        kinds = [(1 << 16, 0)] * 6 + [(1, 1), (1, 1e9)]
        clients = [asyncio.create_task(client(published, *kind)) for kind in kinds]
        await asyncio.sleep(options.seconds)
        status = [str(options.mocapd), "ctl", "--connect", f"unix:{folder}/rig.sock", "status", "--json"]
        status = json.loads(subprocess.run(status, check=True, capture_output=True).stdout)
        added = resident_mb(pid) - before
        for task in clients:
            task.cancel()
        missed = [found["frames_missed"] for found in status["publish"][0]["clients"]]
        print(f"{before:.0f} MB, and {added:.0f} MB with eight clients; they missed {missed} frames; "
              f"the recorder received {status['input']['frames']} frames and lost {status['input']['lost']}")


async def check_end(port, _):
    """Without --loop: the file ends, and can be played again."""
    events, numbers = [], []
    connection = await connected(port, on_event=events.append)
    for times in (1, 2):
        await connection.stream_frames("allframes", ["3d"], lambda packet: numbers.append(packet.framenumber))
        while events.count(QRTEvent.EventRTfromFileStopped) < times:
            await connection.await_event(timeout=10)
        expect(len(numbers) == times * N_FRAMES, f"{len(numbers)} frames")
        await connection.stream_frames_stop()
    expect(numbers == list(range(2 * N_FRAMES)), "frames are missing")
    connection.disconnect()


async def check_crowd(port, _):
    """Ten clients, of which one sends no packets; the eleventh is refused."""
    crowd = [await connected(port) for _ in range(9)]
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET / HTTP/1.1\r\n\r\n")
    await writer.drain()
    numbers = []
    await crowd[0].stream_frames("allframes", ["3d"], lambda packet: numbers.append(packet.framenumber))
    await asyncio.sleep(0.5)
    expect(len(numbers) > 60, f"{len(numbers)} frames")
    crowd.append(await connected(port))
    reader, late = await asyncio.open_connection("127.0.0.1", port)
    refusal = await asyncio.wait_for(reader.read(), 5)
    expect(b"Connection refused. Max number of clients reached." in refusal, refusal)
    for connection in crowd:
        connection.disconnect()
    writer.close()
    late.close()


async def check_recorder_beside(port, options):
    """The recorder and qtm-rt read the same frames at the same time."""
    connection, numbers = await connected(port), []
    await connection.stream_frames("allframes", ["3d"], lambda packet: numbers.append(packet.framenumber))
    for transport in ("tcp", "udp"):
        with tempfile.TemporaryDirectory() as folder:
            record = [options.mocapd, "record", "-d", f"qtm:127.0.0.1:{port}?transport={transport}",
                      "-o", f"{folder}/t.take", "--seconds", "2s", "--json"]
            process = await asyncio.create_subprocess_exec(
                *(str(word) for word in record), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
            output, errors = await process.communicate()
            expect(process.returncode == 0, errors.decode())
            report = json.loads(output)
            expect(report["ledger"]["closes"] and report["frames"] >= 470, output.decode())
            expect(report["markers"] == N_LABELLED, output.decode())
    expect(numbers == list(range(numbers[0], numbers[0] + len(numbers))), "frames are missing")
    connection.disconnect()


def run(checks, more, motion, options):
    """Runs checks one after another, each with a simulator of its own."""
    return [run_one(check, more, motion, options) for check in checks]


def run_one(check, more, motion, options):
    name = check.__name__.removeprefix("check_")
    try:
        is_generated = check in (check_samples, check_bodies, check_published_bodies)
        played = ["--generate", "jump"] if is_generated else [motion]
        with simulator(options.mocapd_sim.resolve(), played, *more) as port:
            asyncio.run(check(port, options))
        return True, f"ok   {name}"
    except Exception as problem:  # any failure is this check's, the others still count
        return False, f"FAIL {name}: {type(problem).__name__}: {problem}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--npm", type=Path, help="the folder with node_modules, to run qualisys-rt")
    parser.add_argument("--crate-client", type=Path, help="the example qtm_client, to run the crate qualisys")
    parser.add_argument("--seconds", type=float, default=20, help="how long each stream of all frames is read")
    parser.add_argument("--memory", action="store_true", help="measure the memory of the service with eight clients")
    options = parser.parse_args()
    options.mocapd = options.mocapd.resolve()
    if options.memory:
        more = ("--markers", "200", "--rate", "1000", "--seconds", "10s", "--loop")
        with simulator(options.mocapd_sim.resolve(), ["--generate", "jump"], *more) as port:
            asyncio.run(measure_memory(port, options))
        return
    endless = [check_stream, check_divisor, check_frequency, check_identity, check_settings, check_one_frame,
               check_datagrams, check_control, check_crowd, check_discovery, check_service, check_recorder_beside]
    if options.npm or options.crate_client:
        endless += [check_other_clients, check_other_clients_of_the_service]
    jobs = [([check], ("--loop",)) for check in endless] + [([check_end], ())]
    jobs += [([check_samples], ("--plates", "--emg", "5@2kHz"))]
    moved = ("--bodies", str(N_BODIES), "--rate", str(RATE_HZ), "--seconds", f"{options.seconds + 60}s")
    # motioncapture always opens the same port for datagrams, so one of it runs at a time; these take longest.
    jobs.insert(0, ([check_bodies, check_published_bodies], moved))
    passed = failed = 0
    with tempfile.TemporaryDirectory() as folder:
        motion = Path(folder) / "motion.csv"
        write_motion(motion)
        # Side by side, because they wait for frames.
        with concurrent.futures.ProcessPoolExecutor(max_workers=4) as pool:
            running = [pool.submit(run, checks, more, motion, options) for checks, more in jobs]
            for is_passed, line in itertools.chain.from_iterable(job.result() for job in running):
                passed += is_passed
                failed += not is_passed
                print(line, flush=True)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
