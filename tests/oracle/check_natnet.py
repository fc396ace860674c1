"""Talks to `mocapd-sim serve --protocol natnet`, and to the service with `[publish.natnet]`, with clients that are not ours:
natnet and motioncapture (libmotioncapture).

    python check_natnet.py --mocapd-sim target/release/mocapd-sim --mocapd target/release/mocapd [--seconds 60]

natnet reads names, numbers, positions and poses; motioncapture reads names and poses of rigid bodies, of the newest frame where
several wait. One line a pair; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import concurrent.futures
import contextlib
import csv
import functools
import itertools
import json
import math
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from in_child import in_child

RATE_HZ = 240
N_FRAMES = 480
CLOCK_HZ = 10_000_000
N_LABELLED = 64
# Half of them belong to a rigid body, the others to no asset with a name.
LABELS = tuple(f"Body:m{k:02}" if k < 32 else f"marker {k:02} <&>" for k in range(N_LABELLED))
UNLABELLED = (f"u{N_LABELLED + 1:03}", f"u{N_LABELLED + 2:03}")
FIRST_ID = 1000
COLUMNS = N_LABELLED + len(UNLABELLED)
VERSIONS = ("2.10", "3.1", "4.1")
TURN_PER_FRAME = 0.01

# It names its port as soon as it has opened it; a machine under load may take seconds to start it.
FIRST_WORD_WITHIN_S = 30.0
# motioncapture waits for ever for a frame that does not come. It ends within seconds of its stream, or half a minute under load.
HANGS_AFTER_S = 60.0


def float32(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


@functools.cache
def position(column, frame):
    """Where a marker is in metres, exactly as float32 has it; None while it is hidden."""
    if (column == 40 and 100 <= frame < 150) or (column == N_LABELLED and 50 <= frame < 120):
        return None
    places = (10.1 * column + 0.5 * frame, -20.7 * column + 0.25 * frame, 1000.3 + 5.0 * column)
    return tuple(float32(float32(v) / 1000.0) for v in places)


@functools.cache
def through_takes(metres):
    """What the recorder makes of metres, millimetres of float32, in metres again: what the service publishes."""
    return tuple(float32(float32(value * 1000.0) / 1000.0) for value in metres)


def write_motion(path):
    names = [f"{label}.{axis}" for label in LABELS + UNLABELLED for axis in "xyz"]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "time_s", *names])
        for frame in range(N_FRAMES):
            cells = [frame, f"{frame / RATE_HZ:.9f}"]
            for column in range(COLUMNS):
                is_hidden = position(column, frame) is None
                places = (10.1 * column + 0.5 * frame, -20.7 * column + 0.25 * frame, 1000.3 + 5.0 * column)
                cells += ["", "", ""] if is_hidden else [repr(float32(v)) for v in places]
            writer.writerow(cells)


def expect(holds, complaint):
    if not holds:
        raise AssertionError(complaint)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@contextlib.contextmanager
def simulator(program, motion, version, is_multicast, *more):
    """A simulated Motive in a process of its own: the port of its commands, and that of its frames."""
    data_port = free_port()
    stream = f"--multicast=239.255.42.99:{data_port}" if is_multicast else f"--data-port={data_port}"
    command = [program, "serve", motion, "--protocol", "natnet", "--loop", "--bitstream", version, stream, *more]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE,
                               stderr=subprocess.DEVNULL, text=True)
    silent = threading.Timer(FIRST_WORD_WITHIN_S, process.kill)
    silent.start()
    try:
        uri = process.stdout.readline().strip()
        silent.cancel()
        expect(uri.startswith("natnet:127.0.0.1:"), f"the simulator names no port: {uri!r}")
        yield int(uri.rpartition(":")[2]), data_port
    finally:
        silent.cancel()
        process.terminate()
        process.wait(10)


def ask(program, folder, *words):
    command = [str(program), "ctl", "--connect", f"unix:{folder}/rig.sock", *words, "--json"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    expect(ran.returncode == 0, f"{words}: {ran.stderr}")
    return json.loads(ran.stdout)


@contextlib.contextmanager
def service(program, device, version, is_multicast, folder):
    """A service that records a device and publishes it as a NatNet server: the port of its commands, and that of its frames."""
    port, data_port = free_port(), free_port()
    stream = f'multicast = "239.255.42.99:{data_port}"' if is_multicast else f"data_port = {data_port}"
    config = Path(folder) / "rig.toml"
    config.write_text(f"""[device]
uri = "{device}"
[take]
directory = "{folder}"
keep_free = "0B"
[arm]
at_start = true
[http]
listen = ""
socket = "{folder}/rig.sock"
[publish.natnet]
enabled = true
listen = "127.0.0.1:{port}"
bitstream = "{version}"
{stream}
""")
    with (Path(folder) / "rig.log").open("w") as log:
        process = subprocess.Popen([str(program), "run", "--config", str(config)], stdout=log, stderr=log)
        try:
            ends_at = time.monotonic() + FIRST_WORD_WITHIN_S
            while True:
                with contextlib.suppress(AssertionError):
                    # The definitions have all markers once the writer knows them.
                    if ask(program, folder, "status")["input"]["frames"] > RATE_HZ:
                        break
                expect(time.monotonic() < ends_at, (Path(folder) / "rig.log").read_text())
                time.sleep(0.1)
            yield port, data_port
        finally:
            process.terminate()
            process.wait(20)


def datagrams_dropped():
    """Datagrams that the system dropped because this process did not read them in time."""
    inodes = set()
    for fd in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            target = os.readlink(f"/proc/self/fd/{fd}")
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    lines = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return sum(int(line[12]) for line in lines if line[9] in inodes)


def published_row(frame):
    """The row of the motion that the service has published, by a marker that is always seen."""
    marker = next(marker for marker in frame.labeled_markers if marker.id_num == 1 << 16 | 1)
    rows = [row for row in range(N_FRAMES) if through_takes(position(0, row)) == marker.pos]
    expect(len(rows) == 1, f"no row has {marker}")
    return rows[0]


def check_natnet_frame(frame, version, first_row=None):
    """One frame as natnet reads it: every marker by its id, and those of the sets. Of the service, whose frame 0 has this row."""
    number = frame.prefix.frame_number
    row = (number + (first_row or 0)) % N_FRAMES
    convert = tuple if first_row is None else through_takes
    by_id = {marker.id_num: marker for marker in frame.labeled_markers}
    places = {}
    for member, column in enumerate(range(32)):
        places[1 << 16 | member + 1] = column
    for member, column in enumerate(range(32, N_LABELLED)):
        places[2 << 16 | member + 1] = column
    for marker_id, column in places.items():
        expected = position(column, row)
        expected = expected and convert(expected)
        marker = by_id.pop(marker_id)
        # Not by `expect`, which would write a message for each of 300 000 markers.
        if marker.occluded != (expected is None) or expected is not None and marker.pos != expected:
            raise AssertionError(f"frame {number} marker {column}: {marker}, not {expected}")
    seen = {FIRST_ID + column: position(column, row) for column in range(N_LABELLED, COLUMNS)}
    seen = {marker_id: convert(place) for marker_id, place in seen.items() if place is not None}
    if version == "2.10":
        expect(not by_id and sorted(frame.unlabeled_marker_pos) == sorted(seen.values()), f"frame {number}")
    elif first_row is None:
        expect({marker_id: marker.pos for marker_id, marker in by_id.items()} == seen, f"frame {number}: {by_id}")
        expect(all(marker.unlabeled for marker in by_id.values()), f"frame {number}")
    else:
        # Unlabelled markers have numbers in the order in which they appeared.
        expect(set(by_id) <= set(range(FIRST_ID, FIRST_ID + 200)), f"frame {number}: {by_id}")
        expect(sorted(marker.pos for marker in by_id.values()) == sorted(seen.values()), f"frame {number}: {by_id}")
        expect(all(marker.unlabeled for marker in by_id.values()), f"frame {number}")
    sets = {one.model_name: one.marker_pos_list for one in frame.marker_sets}
    expect(set(sets) == {"Body", ""} and sets["Body"][5] == convert(position(5, row)), f"frame {number}: {set(sets)}")
    (body,) = frame.rigid_bodies
    if first_row is not None and not body.tracking_valid:
        # Its pose came too late, which the service counts.
        return number
    expect(body.id_num == 1 and body.tracking_valid, f"frame {number}: {body}")
    if first_row is not None:
        expect(body.pos == convert(body_position(row)) and abs(math.hypot(*body.rot) - 1) < 1e-6, f"frame {number}: {body}")
        return number
    turn = number * TURN_PER_FRAME / 2
    rotation = (0.0, math.sin(turn), 0.0, math.cos(turn))
    expect(all(abs(got - wanted) < 1e-6 for got, wanted in zip(body.rot, rotation)), f"frame {number}: {body}")
    return number


def check_natnet(port, data_port, version, is_multicast, seconds, is_service=False, missed=lambda: 0):
    """Every frame is there, or was dropped by the system in front of this client."""
    from natnet import NatNetClient

    frames, descriptions = [], []
    client = NatNetClient(server_ip_address="127.0.0.1", local_ip_address="127.0.0.1", command_port=port,
                          data_port=data_port, use_multicast=is_multicast)
    client.on_data_frame_received_event.handlers.append(frames.append)
    client.on_data_description_received_event.handlers.append(descriptions.append)
    with client:
        info = client.server_info
        expect(info.application_name == ("mocapd" if is_service else "mocapd-sim"), info)
        expect(str(info.nat_net_protocol_version) == f"{version}.0.0", info)
        client.request_modeldef()
        client.run_async()
        time.sleep(seconds)
        client.stop_async()
        dropped = datagrams_dropped()
    expect(descriptions, "no definitions")
    sets = {one.name: one.marker_names for one in descriptions[-1].marker_sets}
    names = tuple(f"{name}:{marker}" if name else marker for name in sets for marker in sets[name])
    expect(names == LABELS, f"names {names}")
    bodies = [(body.name, body.id_num) for body in descriptions[-1].rigid_bodies]
    expect(bodies == [("Body", 1)], bodies)
    first_row = (published_row(frames[0]) - frames[0].prefix.frame_number) % N_FRAMES if is_service else None
    numbers = [check_natnet_frame(frame, version, first_row) for frame in frames]
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    expect(numbers == sorted(set(numbers)), "frames are repeated or out of order")
    counted = missed()
    expect(missing <= dropped + counted, f"{missing} frames are missing, {dropped} datagrams were dropped by the system, and {counted} counted")
    expect(len(numbers) + missing > 0.8 * RATE_HZ * seconds, f"{len(numbers)} frames")
    if version != "2.10":
        # Not the number in front, nor the seconds: the stamp of the exposure.
        steps = {b.suffix.stamp_camera_mid_exposure - a.suffix.stamp_camera_mid_exposure
                 for a, b in zip(frames, frames[1:]) if b.prefix.frame_number == a.prefix.frame_number + 1}
        if is_service:
            # By the host's clock, to which the recording relates the device's.
            period_ns = 1e9 / RATE_HZ
            expect(all(0.5 * period_ns < step < 1.5 * period_ns for step in steps), f"steps of {steps} ns")
            late_ns = [frame.suffix.stamp_data_received - frame.suffix.stamp_camera_mid_exposure for frame in frames]
            expect(-1e6 < min(late_ns) and max(late_ns) < 1e9, f"captured up to {max(late_ns)} ns before its arrival")
        else:
            expect(steps <= {CLOCK_HZ // RATE_HZ, CLOCK_HZ // RATE_HZ + 1}, f"steps of {steps} ticks")
    result = f"{len(numbers)} frames, {missing} missing"
    return (result, sum(not frame.rigid_bodies[0].tracking_valid for frame in frames)) if is_service else result


@functools.cache
def body_position(row):
    """Where the rigid body is: at the mean of its markers, as the simulator computes it."""
    places = [position(column, row) for column in range(32)]
    return tuple(float32(sum(place[axis] for place in places) / len(places)) for axis in range(3))


def check_motioncapture(port, _, version, is_multicast, seconds, is_service):
    """Names and poses of rigid bodies in the newest frames. Those of 2.10 have markers, which this client does not skip: there
    it only reads frames without bodies to their end."""
    import motioncapture

    client = motioncapture.connect("optitrack", {"hostname": "127.0.0.1", "interface_ip": "127.0.0.1",
                                                 "port_command": str(port)})
    convert = through_takes if is_service else tuple
    rows = {convert(body_position(row)): row for row in range(N_FRAMES)}
    expect(len(rows) == N_FRAMES, "two frames have the body at one place")
    count, seen, ends_at = 0, [], time.monotonic() + seconds
    while time.monotonic() < ends_at:
        client.waitForNextFrame()
        read_at, bodies = time.monotonic(), client.rigidBodies
        count += 1
        if version == "2.10":
            expect(not bodies, bodies)
            continue
        # By unicast frames race with the definitions, and this client takes the next datagram for them: its names are empty.
        expect(set(bodies) == {"Body"} or not is_multicast and set(bodies) == {""}, f"bodies {set(bodies)}")
        (body,) = bodies.values()
        place = tuple(float(value) for value in body.position)
        expect(place in rows, f"no frame has the body at {place}")
        seen.append((rows[place], read_at))
        rotation = body.rotation
        length = math.sqrt(rotation.w ** 2 + rotation.x ** 2 + rotation.y ** 2 + rotation.z ** 2)
        expect(abs(length - 1) < 1e-6 and abs(rotation.x) + abs(rotation.z) < 1e-6, f"rotation {rotation}")
    # Those that wait behind the newest are left out by this client.
    expect(count > 10 * seconds, f"{count} frames")
    # The motion comes again after two seconds: a client that was held up for one cannot tell.
    steps = {(later - earlier) % N_FRAMES for (earlier, at), (later, read_at) in zip(seen, seen[1:]) if read_at - at < 0.8}
    expect(all(step < 0.5 * N_FRAMES for step in steps), f"frames go back: {steps}")
    return f"{count} frames"


def bounded_motioncapture(port, data_port, version, is_multicast, seconds, is_service=False, missed=None):
    arguments = (port, data_port, version, is_multicast, seconds, is_service)
    return in_child(check_motioncapture, *arguments, within_s=seconds + HANGS_AFTER_S)


def check_recorder_beside(port, data_port, version, is_multicast, seconds, mocapd):
    """The recorder and natnet read the same frames at the same time."""
    with tempfile.TemporaryDirectory() as folder:
        record = [mocapd, "record", "-d", f"natnet:127.0.0.1:{port}", "-o", f"{folder}/t.take",
                  "--seconds", f"{seconds}s", "--json"]
        process = subprocess.Popen([str(word) for word in record], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        result = check_natnet(port, data_port, version, is_multicast, seconds)
        output, errors = process.communicate(timeout=60)
        expect(process.returncode == 0, errors.decode())
        report = json.loads(output)
        expect(report["ledger"]["closes"] and report["ledger"]["lost_on_link"] == 0, output.decode())
        expect(report["frames"] >= 0.9 * RATE_HZ * seconds, output.decode())
        info = subprocess.run([str(mocapd), "info", f"{folder}/t.take", "--json"], capture_output=True, check=True)
        labels = [channel["label"] for channel in json.loads(info.stdout)["channels"]]
        expect(labels[:N_LABELLED] == list(LABELS), labels)
    return result


def check_service(name, data, version, is_multicast, seconds, mocapd):
    """A client of the service, which records our simulator: as of the simulator itself; and what it counts."""
    port, _ = data
    with tempfile.TemporaryDirectory() as folder:
        with service(mocapd, f"natnet:127.0.0.1:{port}", version, is_multicast, folder) as (published, data_port):
            ask(mocapd, folder, "start", "--name", "published")
            check = check_natnet if "motioncapture" not in name else bounded_motioncapture

            def counted():
                return ask(mocapd, folder, "status")["publish"][0]["frames_missed"]

            result = check(published, data_port, version, is_multicast, seconds, is_service=True, missed=counted)
            (status,) = ask(mocapd, folder, "status")["publish"]
            expect(status["protocol"] == "natnet", status)
            result, n_untracked = result if isinstance(result, tuple) else (result, 0)
            expect(n_untracked <= status["poses_left_out"], f"{n_untracked} frames without a pose: {status}")
            expect(status["frames_sent"] > 0.5 * RATE_HZ * seconds, status)
            stopped = ask(mocapd, folder, "stop")
            expect(stopped["ledger"]["closes"] and stopped["ledger"]["lost_on_link"] == 0, stopped)
    return result


@contextlib.contextmanager
def sampled_device(program, folder):
    """A simulated device with two force plates and two electrodes, on a pseudo-terminal: its URI."""
    command = [program, "serve", "--generate", "jump", "--rate", f"{RATE_HZ}Hz", "--plates=960", "--emg", "2@1920", "--seconds", "120s",
               f"--pty={folder}/device"]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    silent = threading.Timer(FIRST_WORD_WITHIN_S, process.kill)
    silent.start()
    try:
        expect(process.stdout.readline().strip(), "the simulator names no port")
        silent.cancel()
        yield f"serial:{folder}/device"
    finally:
        silent.cancel()
        process.terminate()
        process.wait(10)


def check_samples(program, mocapd, seconds):
    """Force plates and electrodes of the service: as many samples in each frame, and those of the take, in order."""
    import numpy as np
    from natnet import NatNetClient

    # Its definitions of force plates have 12 bytes less than those of others (docs/natnet.md), so that it cannot read these.
    frames = []
    with tempfile.TemporaryDirectory() as folder, sampled_device(program, folder) as device:
        with service(mocapd, device, "4.1", False, folder) as (port, data_port):
            client = NatNetClient(server_ip_address="127.0.0.1", local_ip_address="127.0.0.1", command_port=port,
                                  data_port=data_port, use_multicast=False)
            client.on_data_frame_received_event.handlers.append(frames.append)
            with client:
                ask(mocapd, folder, "start", "--name", "samples")
                client.run_async()
                time.sleep(seconds)
                client.stop_async()
            ask(mocapd, folder, "stop")
            export = [str(mocapd), "export", f"{folder}/samples.take", "-o", f"{folder}/samples.npz"]
            subprocess.run(export, check=True, capture_output=True)
            info = subprocess.run([str(mocapd), "info", f"{folder}/samples.take", "--json"], check=True, capture_output=True)
            archive = dict(np.load(f"{folder}/samples.npz"))
    groups = json.loads(info.stdout)["sampled_groups"]
    expect([len(group["channels"]) for group in groups] == [12, 2], groups)
    # Frames go without samples that have not come, and those of later frames are so much older: the first ones, until frames never
    # wait for a batch, and others on a machine that stands still. Between two of them samples follow each other, but for those
    # that are left out. A lost datagram may have been such a frame.
    runs = [[]]
    number = frames[0].prefix.frame_number
    for frame in frames:
        if lacks_samples(frame) or frame.prefix.frame_number != number:
            runs.append([])
        if not lacks_samples(frame):
            runs[-1].append(frame)
        number = frame.prefix.frame_number + 1
    long_runs = [run for run in runs if len(run) >= RATE_HZ]
    n_compared = sum(map(len, long_runs))
    expect(n_compared > 0.25 * len(frames), f"runs of {[len(run) for run in runs]} of {len(frames)} frames have samples")
    n_samples = sum(compare_samples(run, archive["sampled_0"], archive["sampled_1"]) for run in long_runs)
    return f"{n_compared} of {len(frames)} frames, {n_samples} samples"


def compare_samples(frames, plates, electrodes):
    """Frames without a gap have the samples of the take: their number."""
    import numpy as np

    counts = {(len(frame.force_plates), len(frame.devices)) for frame in frames}
    expect(counts == {(2, 1)}, counts)
    n_samples = 0
    for kind, index, per_frame, taken in (("force_plates", 0, 4, plates[:, :6]), ("force_plates", 1, 4, plates[:, 6:]),
                                          ("devices", 0, 8, electrodes)):
        values = []
        for frame in frames:
            channels = np.array(getattr(frame, kind)[index].channel_arrays, dtype=np.float32)
            expect(channels.shape == (taken.shape[1], per_frame), f"frame {frame.prefix.frame_number}: {channels.shape}")
            values.append(channels.T)
        same_samples(np.concatenate(values), taken.astype(np.float32), per_frame, f"{kind} {index}")
        n_samples += per_frame * len(frames)
    return n_samples


def lacks_samples(frame):
    """Whether a plate or device of a frame has none: those that have not come in time are in the next frame."""
    return any(len(channel) == 0 for entry in (*frame.force_plates, *frame.devices) for channel in entry.channel_arrays)


def same_samples(ours, taken, per_frame, what):
    """What was published is what was recorded, in order. After a moment in which the machine stood still, samples that are behind
    their frames are left out; others are not."""
    # From the first eight frames that occur once: counts are whole numbers, so that fewer may occur by chance, and some frames are
    # from before the take began.
    length = 8 * per_frame
    places = {}
    for place in range(len(taken) - length):
        places.setdefault(taken[place:place + length].tobytes(), []).append(place)
    found = ((first, places.get(ours[first:first + length].tobytes(), ())) for first in range(0, len(ours) - length, per_frame))
    first, at = next(((first, at[0]) for first, at in found if len(at) == 1), (0, 0))
    before = min(first, at)
    expect((ours[first - before:first] == taken[at - before:at]).all(), f"{what}: the take has other samples before {first}")
    n_same, n_left_out = follow(ours[first:], taken[at:], per_frame)
    expect(n_same + before > 0.6 * len(ours) and n_left_out < 0.1 * n_same,
           f"{what}: of {len(ours)} samples {n_same} from {first} on are those of the take, and {n_left_out} were left out")


def follow(ours, taken, per_frame):
    """How many samples are the same, but for those that were left out before a frame, and how many those are."""
    i = at = n_left_out = 0
    while i < len(ours) and at < len(taken):
        n = min(len(ours) - i, len(taken) - at)
        differs = (ours[i:i + n] != taken[at:at + n]).any(axis=1)
        n_same = int(differs.argmax()) if differs.any() else n
        i, at = i + n_same, at + n_same
        if n_same == n:
            break
        frame = ours[i - i % per_frame:][:per_frame]
        i, at = i - i % per_frame, at - i % per_frame
        # A queue holds a second.
        window = range(at + 1, min(at + per_frame * RATE_HZ, len(taken) - per_frame))
        behind = next((place for place in window if (taken[place:place + per_frame] == frame).all()), None)
        if behind is None:
            return 0, 0
        n_left_out += behind - at
        at = behind
    return i, n_left_out


def run_pair(job):
    name, version, is_multicast, program, mocapd, motion, seconds = job
    label = f"{name} {version} {'multicast' if is_multicast else 'unicast'}"
    # This client does not read the markers that rigid bodies have before 3.0.
    more = () if name.startswith("motioncapture") and version == "2.10" else ("--rigid-body", "Body")
    is_service = name.endswith("of the service")
    try:
        if name == "samples of the service":
            return True, f"ok   {label}: {check_samples(program, mocapd, seconds)}"
        served = ("4.1", False) if is_service else (version, is_multicast)
        with simulator(program, motion, *served, *more) as (port, data_port):
            if is_service:
                result = check_service(name, (port, data_port), version, is_multicast, seconds, mocapd)
            elif name == "recorder beside natnet":
                result = check_recorder_beside(port, data_port, version, is_multicast, seconds, mocapd)
            else:
                check = check_natnet if name == "natnet" else bounded_motioncapture
                result = check(port, data_port, version, is_multicast, seconds)
        return True, f"ok   {label}: {result}"
    except Exception as problem:  # any failure is this pair's, the others still count
        return False, f"FAIL {label}: {type(problem).__name__}: {problem}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--seconds", type=int, default=20, help="how long each stream is read")
    parser.add_argument("--only", default="", help="run pairs whose name contains this")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        motion = Path(folder) / "motion.csv"
        write_motion(motion)
        programs = (options.mocapd_sim.resolve(), options.mocapd.resolve(), motion, options.seconds)
        clients = ("natnet", "motioncapture")
        clients += tuple(f"{client} of the service" for client in clients)
        pairs = itertools.product(clients, VERSIONS, (True, False))
        jobs = [(*pair, *programs) for pair in pairs]
        jobs += [("recorder beside natnet", "4.1", is_multicast, *programs) for is_multicast in (True, False)]
        jobs.append(("samples of the service", "4.1", False, *programs))
        jobs = [job for job in jobs if options.only in f"{job[0]} {job[1]} {'multicast' if job[2] else 'unicast'}"]
        passed = 0
        # Side by side: each client has a server of its own. A process for each, because one client has one version.
        with concurrent.futures.ProcessPoolExecutor(max_workers=4, max_tasks_per_child=1) as pool:
            for is_passed, line in pool.map(run_pair, jobs):
                passed += is_passed
                print(line, flush=True)
    print(f"{passed} passed, {len(jobs) - passed} failed")
    sys.exit(passed != len(jobs))


if __name__ == "__main__":
    main()
