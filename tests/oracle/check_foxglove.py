"""Reads the stream of a service with `[publish.foxglove]` with a client that is not ours: Foxglove's own, npm's
@foxglove/ws-protocol. Its messages are decoded with Foxglove's schemas (PyPI's foxglove-schemas-protobuf), and with those that the
stream announces.

    npm ci --prefix FOLDER                      # with package.json and package-lock.json of tests/oracle/npm in FOLDER
    python check_foxglove.py --mocapd target/debug/mocapd --mocapd-sim target/debug/mocapd-sim --npm FOLDER [--seconds 60]

The programs need the feature `full`. One line a check; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import base64
import contextlib
import importlib
import json
import math
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

import check_qtm
from check_qtm import COLUMNS, LABELS, N_FRAMES, N_LABELLED, RATE_HZ, UNLABELLED, expect, float32, position

STEP_NS = 1e9 / RATE_HZ
FORCE_N_PER_M = 1000.0


def schema(name):
    """A message type of Foxglove's own schemas."""
    word = name.removeprefix("foxglove.")
    return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{word}_pb2"), word)


def announced(channel):
    """A message type as the stream describes it."""
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


class Client:
    """Foxglove's client in a process of its own, and what it received."""

    def __init__(self, options, port, topics):
        script = Path(__file__).with_name("foxglove_client.cjs")
        command = ["node", script, options.npm, f"ws://127.0.0.1:{port}", *topics]
        self.process = subprocess.Popen([str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.lines, self.channels, self.messages, self.problems = 0, {}, {}, []
        self.info, self.times = None, []
        self.reader = threading.Thread(target=self.read)
        self.reader.start()

    def read(self):
        for line in self.process.stdout:
            found = json.loads(line)
            match found["kind"]:
                case "info":
                    self.info = found["info"]
                case "channel":
                    self.channels[found["topic"]] = found
                case "time":
                    self.times.append(int(found["time"]))
                case "message":
                    message = (int(found["time"]), base64.b64decode(found["bytes"]))
                    self.messages.setdefault(found["topic"], []).append(message)
                case "status" | "error":
                    self.problems.append(found)

    def of(self, topic):
        return self.messages.get(topic, [])

    def decoded(self, topic):
        """Pairs of a time and a message of Foxglove's schemas, or of the one that was announced."""
        name = self.channels[topic]["schemaName"]
        kind = schema(name) if name.startswith("foxglove.") else announced(self.channels[topic])
        return [(when, kind.FromString(data)) for when, data in self.of(topic)]

    def close(self):
        self.process.stdin.close()
        self.process.wait(30)
        self.reader.join()
        expect(not self.problems, self.problems[:3])
        # A viewer takes a time that falls for a jump, and forgets everything.
        falls = [(a, b) for a, b in zip(self.times, self.times[1:]) if b <= a]
        expect(not falls, f"times fall: {falls[:3]}")


def wait_until(what, holds, seconds=30):
    until = time.monotonic() + seconds
    while not holds():
        expect(time.monotonic() < until, f"{what} took more than {seconds} s")
        time.sleep(0.05)


class Service:
    """A service that records a device and publishes it."""

    def __init__(self, options, device, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.options, self.folder = options, Path(folder)
        config = self.folder / "rig.toml"
        config.write_text(f"""[device]
uri = "{device}"
[take]
directory = "{folder}"
keep_free = "0B"
lossless = true
[arm]
at_start = false
[http]
listen = ""
socket = "{folder}/rig.sock"
[publish.foxglove]
enabled = true
listen = "127.0.0.1:{self.port}"
origins = ["https://app.example.org"]
""")
        self.log = (self.folder / "rig.log").open("w")
        command = [str(options.mocapd), "run", "--config", str(config)]
        self.process = subprocess.Popen(command, stdout=self.log, stderr=self.log)
        wait_until("the service", self.is_open)

    def is_open(self):
        expect(self.process.poll() is None, (self.folder / "rig.log").read_text())
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False

    def ctl(self, *words):
        command = [str(self.options.mocapd), "ctl", "--connect", f"unix:{self.folder}/rig.sock", *words, "--json"]
        done = subprocess.run(command, capture_output=True, text=True)
        expect(done.returncode == 0, f"{words}: {done.stderr}")
        return json.loads(done.stdout)

    def published(self):
        return self.ctl("status")["publish"][0]

    def close(self):
        self.process.terminate()
        self.process.wait(20)
        self.log.close()


def frame_of(spheres_mm):
    """The frame that these markers are in: the first one is never hidden, and moves half a millimetre a frame."""
    return round((spheres_mm[0][0] - position(0, 0)[0]) / 0.5) % N_FRAMES


def mm(point):
    """A point in metres, converted once."""
    return tuple(float32(value * 1000.0) for value in (point.x, point.y, point.z))


def check_times(times, sent, missed):
    """Every frame that was sent has come, and those that are not there were missed; returns their numbers from the first on."""
    numbers = [round((when - times[0]) / STEP_NS) for when in times]
    off = max(abs(when - times[0] - number * STEP_NS) for when, number in zip(times, numbers))
    expect(off < 1000, f"times are off by {off} ns")
    expect(numbers == sorted(set(numbers)), "frames come twice, or in another order")
    expect(numbers[-1] + 1 == len(numbers) + missed, f"{len(numbers)} of {numbers[-1] + 1} frames, and {missed} were missed")
    expect(len(numbers) == sent, f"{len(numbers)} frames arrived, {sent} were sent")
    return numbers


def check_markers(options):
    """64 labelled markers and two others at 240 Hz: every frame, every float, in both topics; the labels."""
    topics = ["/markers", "/spheres", "/names", "/lines", "/tf", "/log"]
    with tempfile.TemporaryDirectory() as folder:
        motion = Path(folder) / "motion.csv"
        check_qtm.write_motion(motion)
        with check_qtm.simulator(options.mocapd_sim, [motion], "--loop") as source:
            service = Service(options, f"qtm:127.0.0.1:{source}", folder)
            client = Client(options, service.port, topics)
            try:
                wait_until("the greeting", lambda: client.info)
                service.ctl("start", "--name", "published")
                time.sleep(options.seconds)
                service.ctl("mark", "here")
                ledger = service.ctl("stop")["ledger"]
                service.ctl("disarm")
                time.sleep(0.5)
                published = service.published()
            finally:
                client.close()
                service.close()
    expect(ledger["closes"] and ledger["recorded"] > 0.9 * RATE_HZ * options.seconds, ledger)
    expect(ledger["frames_sent"] == ledger["recorded"], ledger)
    expect(client.info["capabilities"] == ["time"], client.info)
    report = published["clients"][0]
    expect(report["version"] == "foxglove.websocket.v1" and not report["frames_missed"], report)
    sent, first = report["frames_sent"], None
    spheres, clouds = client.decoded("/spheres"), client.decoded("/markers")
    numbers = check_times([when for when, _ in spheres], sent, report["frames_missed"])
    expect([when for when, _ in clouds] == [when for when, _ in spheres], "the topics have other times")
    of_frames = set(client.times) & {when for when, _ in spheres}
    expect(len(of_frames) == sent, f"{len(of_frames)} times for {sent} frames")
    for number, (when, scene), (_, cloud) in zip(numbers, spheres, clouds):
        entity = scene.entities[0]
        expect((entity.id, entity.frame_id) == ("markers", "mocap"), entity.id)
        expect(entity.timestamp.ToNanoseconds() == when, "the entity has another time")
        found = [mm(sphere.pose.position) for sphere in entity.spheres]
        first = frame_of(found) if first is None else first
        frame = (first + number) % N_FRAMES
        seen = {column: position(column, frame) for column in range(COLUMNS)}
        seen = {column: at for column, at in seen.items() if at is not None}
        # Unlabelled markers, which appear with the first frames, get their columns in that order.
        labelled = [at for column, at in seen.items() if column < N_LABELLED]
        expect(found[:len(labelled)] == labelled, f"frame {frame}: {found[:3]}, not {labelled[:3]}")
        expect(sorted(found[len(labelled):]) == sorted(list(seen.values())[len(labelled):]), f"frame {frame}: unlabelled markers")
        points = list(struct.iter_unpack("<fffHxx", cloud.data))
        expect(len(points) == len(found), f"frame {frame}: {len(points)} points")
        for (*point, column), at in zip(points, found):
            expect(tuple(point) == tuple(float32(value / 1000.0) for value in at), f"frame {frame}: {point}, not {at}")
            expect(column >= N_LABELLED or seen[column] == at, f"frame {frame}: column {column}")
    check_names(client, first)
    texts = [entry.message for _, entry in client.decoded("/log")]
    for text in ("recording published", "here", "none lost", "0 frames lost"):
        expect(any(text in entry for entry in texts), f"{text!r} is not in the log: {texts}")
    rate_hz = len(client.of("/names")) / (len(spheres) / RATE_HZ)
    expect(9 < rate_hz < 13, f"labels at {rate_hz} Hz")


def check_names(client, first):
    start = client.of("/spheres")[0][0]
    for when, scene in client.decoded("/names"):
        entity, frame = scene.entities[0], (first + round((when - start) / STEP_NS)) % N_FRAMES
        columns = {int(pair.key): pair.value for pair in entity.metadata}
        expect([columns[column] for column in range(N_LABELLED)] == list(LABELS), columns)
        texts = {text.text: mm(text.pose.position) for text in entity.texts}
        for column, label in enumerate(LABELS):
            expect(texts.get(label) == position(column, frame), f"{label} in frame {frame}: {texts.get(label)}")
        # Unlabelled markers have labels once the writer knows them.
        n_known = sum(position(column, frame) is not None for column in range(len(columns)))
        expect(len(entity.texts) == n_known, f"{len(entity.texts)} labels of {n_known}")
        n_unlabelled = len(columns) - N_LABELLED
    expect(n_unlabelled == len(UNLABELLED), f"{n_unlabelled} unlabelled markers at the end")


def values_of(message):
    """The bytes of a message without its time, which is its first field."""
    expect(message[0] == 0x0A and message[1] < 0x80, message[:2])
    return message[2 + message[1]:]


def overlap(live, expected):
    """The number of messages in which two sequences agree, of which one begins somewhere in the other."""
    for a, b in ((live, expected), (expected, live)):
        for at in (at for at, value in enumerate(b) if value == a[0]):
            n = min(len(a), len(b) - at)
            if a[:n] == b[at:at + n] and n > len(b) // 2:
                return n
    return 0


def check_recorded(options):
    """Force plates, electrodes and bodies: what was sent live is what an export of the take to MCAP has."""
    topics = ["/markers", "/sampled_0", "/sampled_1", "/force_plates", "/forces", "/tf"]
    motion = ["--generate", "jump", "--seconds", "4s", "--plates", "--emg", "3@2kHz", "--bodies", "2"]
    with tempfile.TemporaryDirectory() as folder:
        line = Path(folder) / "line"
        command = [options.mocapd_sim, "serve", *motion, f"--pty={line}"]
        simulator = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        service = client = None
        try:
            wait_until("the simulator", line.exists)
            service = Service(options, f"serial:{line}", folder)
            client = Client(options, service.port, topics)
            wait_until("the greeting", lambda: client.info)
            path = service.ctl("start", "--name", "published")["path"]
            wait_until("the end of the motion", lambda: service.ctl("status")["state"] != "recording")
            time.sleep(0.5)
            published = service.published()
        finally:
            simulator.terminate()
            simulator.wait(10)
            if client:
                client.close()
            if service:
                service.close()
        exported = Path(folder) / "published.mcap"
        subprocess.run([str(options.mocapd), "export", path, "-o", str(exported)], check=True, capture_output=True)
        stored, schemas = {}, {}
        with exported.open("rb") as file:
            for of, channel, message in make_reader(file).iter_messages():
                stored.setdefault(channel.topic, []).append(message)
                schemas[channel.topic] = of.data
    (report,) = published["clients"]
    expect((report["frames_missed"], report["batches_missed"]) == (0, 0), report)
    for topic in topics[:4]:
        live = [values_of(data) for _, data in client.of(topic)]
        expected = [values_of(message.data) for message in stored[topic]]
        # Those of before the subscription are in the take alone, and those of before its start were sent alone.
        n = overlap(live, expected)
        expect(n > 0.8 * len(expected), f"{topic}: {n} messages agree of {len(live)}, and {len(expected)} in the take")
        announced_schema = base64.b64decode(client.channels[topic]["schema"])
        expect(announced_schema == schemas[topic], f"{topic}: the schema differs from that of the export")
        times = [when for when, _ in client.of(topic)]
        steps = [b - a for a, b in zip(times, times[1:])]
        expect(max(steps) - min(steps) <= 3000, f"{topic}: steps of {min(steps)} to {max(steps)} ns")
    check_forces(client)
    bodies = client.decoded("/tf")
    # Frames from before bodies were wanted go without.
    missing = len(client.of("/markers")) - len(bodies)
    at_first = [when for when, _ in client.of("/markers")][missing:]
    expect(0 <= missing < 0.05 * len(bodies) and at_first == [when for when, _ in bodies], "not a transform for each frame")
    without = 0
    for _, message in bodies:
        frames = [(of.parent_frame_id, of.child_frame_id) for of in message.transforms]
        expect(frames[0] == ("world", "mocap") and len(frames) in (1, 3), frames)
        # Their poses came too late, which the service counts.
        without += len(frames) == 1
        expect(all(parent == "mocap" for parent, _ in frames[1:]), frames)
        for of in message.transforms:
            length = math.hypot(of.rotation.x, of.rotation.y, of.rotation.z, of.rotation.w)
            expect(abs(length - 1.0) < 1e-6, f"a rotation of length {length}")
    expect(without < 0.1 * len(bodies), f"{without} of {len(bodies)} frames without bodies")
    expect(without <= published["poses_left_out"], f"{without} frames without bodies: {published}")


def check_forces(client):
    """Every arrow is the load of the sample that its time has."""
    kind, found, loads = announced(client.channels["/force_plates"]), 0, {}
    for when, data in client.of("/force_plates"):
        loads[when] = kind.FromString(data)
    scenes = client.decoded("/forces")
    expect(len(scenes) > 40, f"{len(scenes)} scenes of forces")
    for when, scene in scenes:
        entity = scene.entities[0]
        expect(len(entity.lines) >= 1 and all(len(line.points) == 4 for line in entity.lines), "the outlines")
        load = loads[when]
        force = math.hypot(load.force_plate_1_force_x_n, load.force_plate_1_force_y_n, load.force_plate_1_force_z_n)
        for arrow in entity.arrows:
            length_n = (arrow.shaft_length + arrow.head_length) * FORCE_N_PER_M
            found += abs(length_n - force) < 1e-3 * max(1.0, force)
    expect(found > 20, f"{found} arrows have the force of a sample")


def answer_to(port, *headers):
    """The first line of the answer to a handshake."""
    request = ["GET / HTTP/1.1", f"Host: 127.0.0.1:{port}", *headers, "", ""]
    with socket.create_connection(("127.0.0.1", port), 5) as connection:
        connection.sendall("\r\n".join(request).encode())
        connection.settimeout(5)
        return connection.recv(4096).decode("latin-1")


def check_strangers(options):
    """Pages that are not listed, other protocols and other subprotocols are refused, with a message that says what to do."""
    with tempfile.TemporaryDirectory() as folder:
        service = Service(options, f"serial:{folder}/none", folder)
        try:
            upgrade = ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
                       "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="]
            ours = "Sec-WebSocket-Protocol: foxglove.sdk.v1"
            accepted = [[ours], [ours, "Origin: https://app.example.org"], [ours, "Origin: file://"]]
            for more in accepted:
                answer = answer_to(service.port, *upgrade, *more)
                expect(answer.startswith("HTTP/1.1 101 ") and "foxglove.sdk.v1" in answer, (more, answer))
            for origin in ("https://evil.example", "null", "http://app.example.org", "https://app.example.org.evil.example"):
                answer = answer_to(service.port, *upgrade, ours, f"Origin: {origin}")
                expect(answer.startswith("HTTP/1.1 403 ") and "publish.foxglove.origins" in answer, (origin, answer))
            answer = answer_to(service.port, *upgrade, "Sec-WebSocket-Protocol: ros")
            expect(answer.startswith("HTTP/1.1 400 ") and "foxglove.websocket.v1" in answer, answer)
            answer = answer_to(service.port)
            expect(answer.startswith("HTTP/1.1 400 ") and "Foxglove" in answer, answer)
            wait_until("the refusals", lambda: service.published()["clients_refused"] == 6)
        finally:
            service.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    parser.add_argument("--npm", required=True, type=Path, help="the folder with node_modules")
    parser.add_argument("--seconds", type=float, default=20, help="how long the stream of markers is read")
    options = parser.parse_args()
    options.mocapd, options.mocapd_sim = options.mocapd.resolve(), options.mocapd_sim.resolve()
    checks = [check_markers, check_recorded, check_strangers]
    passed = 0
    for check in checks:
        name = check.__name__.removeprefix("check_")
        try:
            check(options)
            print(f"ok   {name}", flush=True)
            passed += 1
        except Exception as problem:  # any failure is this check's, the others still count
            print(f"FAIL {name}: {type(problem).__name__}: {problem}", flush=True)
    print(f"{passed} passed, {len(checks) - passed} failed")
    sys.exit(passed != len(checks))


if __name__ == "__main__":
    main()
