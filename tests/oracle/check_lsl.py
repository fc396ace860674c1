"""Talks to our side of the Lab Streaming Layer with one that is not ours: liblsl, through pylsl. XDF files are read by pyxdf.
Our side is the simulator, and the service with `[publish.lsl]`.

    python check_lsl.py --mocapd-sim target/release/mocapd-sim --mocapd target/release/mocapd [--seconds 60]

All checks run side by side, in an LSL session of their own. One line a check; the last line is `N passed, N failed`; exit code 1
when one failed.
"""

import argparse
import concurrent.futures
import contextlib
import csv
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

# Tests that run at the same time have streams, too: they use a session and ports of their own.
SESSION = f"mocapd-{os.getpid()}"
CONFIGURATION = f"""[ports]
BasePort={17_000 + os.getpid() % 400 * 32}
[multicast]
ResolveScope=machine
[lab]
KnownPeers={{127.0.0.1}}
SessionID={SESSION}
"""

RATE_HZ = 240
N_MARKERS = 64
LABELS = tuple(f"marker {k:02} <&>" for k in range(N_MARKERS))
N_FRAMES = 480

# It names its streams as soon as it has opened them; a machine under load may take seconds to start it.
FIRST_WORD_WITHIN_S = 30.0


def expect(holds, complaint):
    if not holds:
        raise AssertionError(complaint)


def positions_mm():
    """N_FRAMES x markers x 3, exactly as float32 has them; marker 1 is hidden for a while."""
    frame = np.arange(N_FRAMES)[:, None, None]
    marker = np.arange(N_MARKERS)[None, :, None]
    start = np.array([10.1, -20.7, 5.0]) * marker + np.array([0.0, 0.0, 1000.3])
    positions = (start + np.array([0.5, 0.25, 0.0]) * frame).astype(np.float32)
    positions[100:150, 1] = np.nan
    return positions


def write_motion(path):
    names = [f"{label}.{axis}" for label in LABELS for axis in "xyz"]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "time_s", *names])
        for frame, row in enumerate(positions_mm()):
            cells = ["" if np.isnan(value) else repr(float(value)) for value in row.ravel()]
            writer.writerow([frame, f"{frame / RATE_HZ:.9f}", *cells])


@contextlib.contextmanager
def simulator(options, *more):
    """A simulated source of streams: the names of its streams."""
    command = [options.mocapd_sim, "serve", *more, "--protocol", "lsl"]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    silent = threading.Timer(FIRST_WORD_WITHIN_S, process.kill)
    silent.start()
    try:
        uri = process.stdout.readline().strip()
        silent.cancel()
        expect(uri.startswith("lsl:"), f"the simulator names no stream: {uri!r}")
        yield uri.removeprefix("lsl:").split(",")
    finally:
        silent.cancel()
        process.terminate()
        process.wait(10)


@contextlib.contextmanager
def publisher(kind, name, *more):
    """An outlet of pylsl in a process of its own."""
    command = [sys.executable, __file__, "--publish", kind, name, *(str(word) for word in more)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        expect(process.stdout.readline().strip() == "open", f"no outlet {name}")
        yield process
    finally:
        process.kill()
        process.wait(10)


def record(options, uri, take, *more):
    command = [options.mocapd, "record", "-d", uri, "-o", take, "--lossless", "--json", *more]
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=120, check=False)


def recorded(options, uri, take, *more, code=0):
    ran = record(options, uri, take, *more)
    expect(ran.returncode == code, f"exit code {ran.returncode}: {ran.stderr}")
    report = json.loads(ran.stdout)
    expect(report["ledger"]["closes"], ran.stdout)
    return report, ran.stderr


def xdf_of(options, take):
    """The streams of a take's XDF file by their types, but for that of its rigid bodies, which has the type of the markers."""
    import pyxdf
    path = Path(take).with_suffix(".xdf")
    subprocess.run([str(options.mocapd), "export", str(take), "-o", str(path)], check=True, capture_output=True)
    streams, _ = pyxdf.load_xdf(str(path), dejitter_timestamps=False)
    return {stream["info"]["type"][0]: stream for stream in streams if not stream["info"]["name"][0].endswith("poses")}


def info_of(options, take):
    ran = subprocess.run([str(options.mocapd), "info", str(take), "--json"], check=True, capture_output=True, text=True)
    return json.loads(ran.stdout)


# Outlets of pylsl, in processes of their own.

def described(info, labels, kind, unit, marker=None):
    channels = info.desc().append_child("channels")
    for label in labels:
        channel = channels.append_child("channel")
        channel.append_child_value("label", label)
        if marker:
            channel.append_child_value("marker", marker(label))
        channel.append_child_value("type", kind(label))
        channel.append_child_value("unit", unit)
    return info


def value(sample, channel):
    """What every publisher of numbers sends."""
    return np.float32(0.001 * sample + 0.1 * channel - 1.0)


def paced(outlet, rate_hz, seconds, samples_of):
    import pylsl
    outlet.wait_for_consumers(60)
    start_s = pylsl.local_clock()
    for number in range(int(rate_hz * seconds)):
        at_s = start_s + number / rate_hz
        time.sleep(max(0.0, at_s - pylsl.local_clock()))
        outlet.push_sample(samples_of(number), at_s)


def publish(kind, name, rest):
    import pylsl
    source_id = f"source {name}"
    if kind == "mocap":
        n, unit = 9, rest[0] if rest else "millimeters"
        labels = [f"M{k}.{axis}" for k in range(3) for axis in "xyz"]
        info = pylsl.StreamInfo(name, "MoCap", n, 100, "float32", source_id)
        described(info, labels, lambda label: f"Position{label[-1].upper()}", unit, lambda label: label[:-2])
    elif kind == "eeg":
        n = 70
        info = pylsl.StreamInfo(name, "EEG", n, 500, "double64", source_id)
        described(info, [f"E{k}" for k in range(n)], lambda _: "EEG", "microvolts")
    elif kind == "irregular":
        n = 2
        info = pylsl.StreamInfo(name, "Gaze", n, 0, "float32", source_id)
    else:
        n = 1
        info = pylsl.StreamInfo(name, "Markers", 1, 0, "string", source_id)
    outlet = pylsl.StreamOutlet(info)
    print("open", flush=True)
    rate_hz = {"mocap": 100, "eeg": 500}.get(kind, 10)
    if kind == "strings":
        paced(outlet, rate_hz, 600, lambda number: [f"mark {number} äöü"])
    elif kind == "irregular":
        import random
        outlet.wait_for_consumers(60)
        for number in range(6000):
            outlet.push_sample([value(number, channel) for channel in range(n)])
            time.sleep(random.uniform(0.01, 0.15))
    else:
        paced(outlet, rate_hz, 600, lambda number: [value(number, channel) for channel in range(n)])


def inlet_of(name):
    import pylsl
    found = pylsl.resolve_byprop("name", name, 1, 20)
    expect(len(found) == 1, f"pylsl finds {len(found)} streams {name}")
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(20)
    return inlet


def pulled(inlet, seconds, ages=None):
    """Samples and time stamps of so many seconds; and in `ages` how old the newest of each piece was by this machine's clock."""
    import pylsl
    samples, stamps, until = [], [], time.monotonic() + seconds
    while time.monotonic() < until:
        more, at = inlet.pull_chunk(timeout=0.1, max_samples=4096)
        samples += more
        stamps += at
        if ages is not None and at:
            ages.append(pylsl.local_clock() - at[-1])
    return samples, np.array(stamps)


def expect_recent(ages, what):
    """Stamps are by this machine's clock: never ahead of it, and most of them a moment behind."""
    expect(min(ages) > -1e-3, f"{what}: a stamp is {-min(ages)} s ahead of the clock")
    expect(np.median(ages) < 0.2, f"{what}: stamps are {np.median(ages)} s behind the clock")


def channels_of(description):
    """Label, marker, type and unit of each channel, from a description by pylsl."""
    channel, found = description.desc().child("channels").child("channel"), []
    while not channel.empty():
        found.append(tuple(channel.child_value(key) for key in ("label", "marker", "type", "unit")))
        channel = channel.next_sibling("channel")
    return found


def check_outlet(options, folder):
    """pylsl reads our stream of positions: every sample, bit for bit, with its name and time."""
    with simulator(options, folder / "motion.csv", "--loop", "--serial", "outlet") as names:
        inlet = inlet_of(names[0])
        expected = [(f"{label}.{axis.lower()}", label, f"Position{axis}", "meters") for label in LABELS for axis in "XYZ"]
        description = inlet.info(10)
        expect(channels_of(description) == expected, "the channels")
        expect((description.nominal_srate(), description.type()) == (RATE_HZ, "MoCap"), description.as_xml()[:400])
        samples, stamps = pulled(inlet, options.seconds)
    metres = (positions_mm().astype(np.float64) / 1000).astype(np.float32)
    got = np.array(samples, dtype=np.float32).reshape(len(samples), N_MARKERS, 3)
    expect(len(got) > 0.9 * RATE_HZ * (options.seconds - 1.5), f"{len(got)} samples")
    wanted = metres[np.arange(len(got)) % N_FRAMES]
    wrong = np.flatnonzero(~((got == wanted) | (np.isnan(got) & np.isnan(wanted))).all(axis=(1, 2)))
    expect(len(wrong) == 0, f"samples {wrong[:5]} of {len(got)} differ")
    steps = np.diff(stamps) * RATE_HZ
    expect(np.abs(steps - 1).max() < 1e-3, f"steps of {steps.min()} to {steps.max()} periods")
    return f"{len(got)} samples"


def check_same_stream(options, folder):
    """One stream of positions, recorded by pylsl and by us: the same samples, and times within 1 ms."""
    name, take = f"same {SESSION}", folder / "same.take"
    with publisher("mocap", name):
        inlet = inlet_of(name)
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            theirs = pool.submit(pulled, inlet, 9)
            report, _ = recorded(options, f"lsl:{name}", take, "--seconds", "4s")
            samples, stamps = theirs.result()
    stream = xdf_of(options, take)["MoCap"]
    ours = np.array(stream["time_series"], dtype=np.float32)
    theirs = np.array(samples, dtype=np.float32)
    expect(380 <= len(ours) == report["frames"], f"{len(ours)} samples, {report['frames']} frames")
    first = int(round((float(ours[0][0]) + 1.0) / 0.001))
    sent = np.array([[value(first + k, c) for c in range(9)] for k in range(len(ours))], dtype=np.float32)
    expect((ours == sent).all(), "we have other samples than were sent")
    at = int(np.flatnonzero((theirs == ours[0]).all(axis=1))[0])
    expect((theirs[at:at + len(ours)] == ours).all(), "pylsl has other samples than we")
    stamps = stamps[at:at + len(ours)]
    apart = np.abs((stamps - stamps[0]) - np.array(stream["time_stamps"]))
    expect(apart.max() < 1e-3, f"times differ by {1e3 * apart.max()} ms")
    labels = [channel["label"][0] for channel in stream["info"]["desc"][0]["channels"][0]["channel"]]
    expect(labels == [f"M{k}.{axis}" for k in range(3) for axis in "xyz"], labels)
    clock = info_of(options, take)["clock"]
    ahead_ns = clock["at"]["host_ns"] - clock["at"]["device_ticks"]
    expect(clock["method"] == "round trips" and abs(ahead_ns) < 1e6, f"one machine's clocks are {ahead_ns} ns apart: {clock}")
    expect(abs(ahead_ns) <= 1e3 * clock["bound_us"], f"{ahead_ns} ns is not within the stated bound: {clock}")
    return f"{len(ours)} samples, times within {1e6 * apart.max():.0f} us"


def check_units(options, folder):
    """Metres are converted once; positions without a unit need one."""
    name, take = f"units {SESSION}", folder / "units.take"
    with publisher("mocap", name, "meters"):
        recorded(options, f"lsl:{name}", take, "--seconds", "2s")
    ours = np.array(xdf_of(options, take)["MoCap"]["time_series"], dtype=np.float32)
    first = int(round((float(ours[0][0]) / 1000 + 1.0) / 0.001))
    sent = np.array([[value(first + k, c) for c in range(9)] for k in range(len(ours))], dtype=np.float32)
    expect((ours == (sent.astype(np.float64) * 1000).astype(np.float32)).all(), "not the floats sent, times 1000")
    with publisher("mocap", f"{name} none", ""):
        ran = record(options, f"lsl:{name} none", folder / "none.take", "--seconds", "1s")
        expect(ran.returncode == 1 and "?unit=m" in ran.stderr, ran.stderr)
        recorded(options, f"lsl:{name} none?unit=mm", folder / "given.take", "--seconds", "1s")
    return f"{len(ours)} samples"


def check_eeg_and_events(options, folder):
    """70 channels of doubles and a stream of texts in one take, read back from its XDF file."""
    eeg, marks, take = f"eeg {SESSION}", f"marks {SESSION}", folder / "eeg.take"
    with publisher("eeg", eeg), publisher("strings", marks):
        report, _ = recorded(options, f"lsl:{eeg},{marks}", take, "--seconds", "4s")
    info = info_of(options, take)
    groups = info["sampled_groups"]
    expect([len(group["channels"]) for group in groups] == [64, 6], groups)
    expect(all(group["samples"] >= 1900 and group["rate_hz"] == 500 for group in groups), groups)
    expect(groups[0]["channels"][3]["name"] == "E3" and groups[0]["channels"][3]["unit"] == "microvolts", groups[0])
    expect(info["sample_ledger"]["closes"], info["sample_ledger"])
    marks = [event for event in info["events"] if event["kind"] == "mark"]
    texts = [event["text"] for event in marks]
    first = int(texts[0].split()[1])
    # They were sent every 100 ms, and have their own time stamps.
    steps_ns = np.diff([event["device_ticks"] for event in marks])
    expect(np.abs(steps_ns - 1e8).max() < 1e3, f"{steps_ns} ns from event to event")
    # One that comes before the frames of its time is in the frame after the last: on a busy machine some frames off.
    expect(np.abs(np.diff([event["frame"] for event in marks]) - 10).max() <= 8, [event["frame"] for event in marks])
    expect(len(texts) >= 30 and texts == [f"mark {first + k} äöü" for k in range(len(texts))], texts)
    expect(report["ledger"]["recorded"] >= 380, report)
    return f"{groups[0]['samples']} samples, {len(texts)} events"


def check_irregular(options, folder):
    """Samples without a rate are events with their values; they need another stream beside them."""
    gaze, mocap, take = f"gaze {SESSION}", f"beside {SESSION}", folder / "gaze.take"
    with publisher("irregular", gaze), publisher("mocap", mocap):
        _, notes = recorded(options, f"lsl:{mocap},{gaze}", take, "--seconds", "3s")
        alone = record(options, f"lsl:{gaze}", folder / "alone.take", "--seconds", "1s")
    expect(alone.returncode == 1 and "events alone are no recording" in alone.stderr, alone.stderr)
    expect("states no rate" in notes, notes)
    texts = [event["text"] for event in info_of(options, take)["events"] if event["kind"] == "mark"]
    first = int(round((float(texts[0].split()[0]) + 1.0) / 0.001))
    sent = [[value(first + k, channel) for channel in range(2)] for k in range(len(texts))]
    got = [[np.float32(number) for number in text.split()] for text in texts]
    expect(len(got) >= 15 and got == sent, f"{got[:3]}, not {sent[:3]}")
    return f"{len(texts)} events"


def check_outage(options, folder):
    """A stream that dies and comes back is an outage with its cause; the take goes on."""
    name, take = f"dies {SESSION}", folder / "dies.take"
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        with publisher("mocap", name):
            ours = pool.submit(recorded, options, f"lsl:{name}", take, "--seconds", "10s", code=3)
            time.sleep(4)
        time.sleep(1.5)
        with publisher("mocap", name):
            report, notes = ours.result()
    expect("is over" in notes and "the device is back" in notes, notes)
    expect(report["outages"]["count"] == 1, report)
    ledger = report["ledger"]
    away = ledger["frames_sent"] - ledger["recorded"]
    expect(100 <= away and ledger["recorded"] >= 400, ledger)
    return f"{ledger['recorded']} frames, {away} while it was away"


def check_others_go_on(options, folder):
    """A stream of events that dies and comes back ends nothing: frames go on, and its texts come again."""
    mocap, marks, take = f"goes on {SESSION}", f"comes back {SESSION}", folder / "others.take"
    with publisher("mocap", mocap), concurrent.futures.ThreadPoolExecutor(1) as pool:
        with publisher("strings", marks):
            ours = pool.submit(recorded, options, f"lsl:{mocap},{marks}", take, "--seconds", "9s")
            time.sleep(3.5)
        time.sleep(1)
        with publisher("strings", marks):
            report, notes = ours.result()
    expect(f"'{marks}' is over" in notes and f"'{marks}' is back" in notes, notes)
    expect(report["ledger"]["recorded"] >= 880 and report["outages"]["count"] == 0, report)
    numbers = [int(event["text"].split()[1]) for event in info_of(options, take)["events"] if event["kind"] == "mark"]
    # The second program counts from 0 again.
    again = max(at for at, number in enumerate(numbers) if number == 0)
    expect(10 <= again <= len(numbers) - 10 and numbers[again:] == list(range(len(numbers) - again)), numbers)
    return f"{report['ledger']['recorded']} frames, {len(numbers)} events"


def check_names(options, folder):
    """Errors say what was found and what to do."""
    name = f"names {SESSION}"
    with publisher("strings", name), publisher("mocap", name):
        nobody = record(options, "lsl:nobody", folder / "x.take", "--seconds", "1s")
        expect(nobody.returncode == 1 and "no stream 'nobody'" in nobody.stderr and "found: '" in nobody.stderr, nobody.stderr)
        # One of the two may answer late on a busy machine.
        for _ in range(3):
            several = record(options, f"lsl:{name}", folder / "x.take", "--seconds", "1s")
            if "streams match" in several.stderr:
                break
        expect(several.returncode == 1 and "2 streams match" in several.stderr, several.stderr)
        for _ in range(3):
            chosen = record(options, f"lsl:{name}?type=MoCap", folder / "one.take", "--seconds", "1s")
            if "with these properties answers" not in chosen.stderr:
                break
        expect(chosen.returncode == 0 and json.loads(chosen.stdout)["ledger"]["closes"], chosen.stderr)
    return "3 answers"


def check_convention(options, folder):
    """Our stream and our XDF file describe the same motion in the same way; only the unit differs."""
    with simulator(options, folder / "motion.csv", "--loop", "--serial", "convention") as names:
        inlet = inlet_of(names[0])
        ours = channels_of(inlet.info(10))
        recorded(options, f"lsl:{names[0]}", folder / "convention.take", "--seconds", "2s")
    stream = xdf_of(options, folder / "convention.take")["MoCap"]
    channels = stream["info"]["desc"][0]["channels"][0]["channel"]
    written = [tuple(channel[key][0] for key in ("label", "marker", "type", "unit")) for channel in channels]
    expect([channel[:3] for channel in ours] == [channel[:3] for channel in written], "labels, markers or types")
    expect({channel[3] for channel in ours} == {"meters"} and {channel[3] for channel in written} == {"millimeters"}, "units")
    got = np.array(stream["time_series"], dtype=np.float32).reshape(-1, N_MARKERS, 3)
    metres = (positions_mm().astype(np.float64) / 1000).astype(np.float32)
    millimetres = (metres.astype(np.float64) * 1000).astype(np.float32)
    first = int(np.flatnonzero((millimetres[:, 0] == got[0, 0]).all(axis=1))[0])
    wanted = millimetres[(first + np.arange(len(got))) % N_FRAMES]
    expect(((got == wanted) | (np.isnan(got) & np.isnan(wanted))).all(), "positions")
    return f"{len(got)} samples"


def ask(options, folder, *words):
    command = [options.mocapd, "ctl", "--connect", f"unix:{folder}/rig.sock", *words, "--json"]
    ran = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=60, check=False)
    expect(ran.returncode == 0, f"{words}: {ran.stderr}")
    return json.loads(ran.stdout)


@contextlib.contextmanager
def service(options, device, folder, rig):
    """A service that records a device and publishes it."""
    folder.mkdir()
    config = folder / f"{rig}.toml"
    config.write_text(f"""[device]
uri = "{device}"
[take]
directory = "{folder}"
keep_free = "0B"
lossless = true
[arm]
at_start = true
[http]
listen = ""
socket = "{folder}/rig.sock"
[publish.lsl]
enabled = true
""")
    with (folder / "rig.log").open("w") as log:
        process = subprocess.Popen([str(options.mocapd), "run", "--config", str(config)], stdout=log, stderr=log)
        try:
            ends_at = time.monotonic() + FIRST_WORD_WITHIN_S
            while True:
                with contextlib.suppress(AssertionError):
                    if ask(options, folder, "status")["input"]["frames"] > RATE_HZ:
                        break
                expect(time.monotonic() < ends_at, (folder / "rig.log").read_text())
                time.sleep(0.1)
            yield
        finally:
            process.terminate()
            process.wait(20)


@contextlib.contextmanager
def natnet_simulator(options, motion, *more):
    """A simulated Motive: the URI to record from."""
    command = [options.mocapd_sim, "serve", motion, "--protocol", "natnet", "--loop", "--data-port=1519", *more]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    silent = threading.Timer(FIRST_WORD_WITHIN_S, process.kill)
    silent.start()
    try:
        uri = process.stdout.readline().strip()
        silent.cancel()
        expect(uri.startswith("natnet:"), f"the simulator names no port: {uri!r}")
        yield uri
    finally:
        silent.cancel()
        process.terminate()
        process.wait(10)


def check_service(options, folder):
    """pylsl reads what the service records, beside the recording: every frame, pose and event, and the take has the same."""
    rig, labels = f"rig{os.getpid()}", LABELS[:-4]
    motion = folder / "bodies.csv"
    lines = (folder / "motion.csv").read_text().splitlines()
    renamed = tuple(f"Wand:m{k}" for k in range(4))
    for label, name in zip(LABELS[-4:], renamed):
        lines[0] = lines[0].replace(f"{label}.", f"{name}.")
    motion.write_text("\n".join(lines) + "\n")
    run = folder / "service"
    with natnet_simulator(options, motion, "--rigid-body", "Wand") as uri, service(options, uri, run, rig):
        inlets = [inlet_of(f"{rig}{suffix}") for suffix in ("", "-poses", "-events")]
        descriptions = [inlet.info(10) for inlet in inlets]
        stated = channels_of(descriptions[0])
        names = [channel[1] for channel in stated[::3]]
        expect(sorted(names) == sorted(labels + renamed), names)
        expected = [(f"{name}.{axis.lower()}", name, f"Position{axis}", "meters") for name in names for axis in "XYZ"]
        expect(stated == expected, stated)
        kinds = ["PositionX", "PositionY", "PositionZ", "OrientationA", "OrientationB", "OrientationC", "OrientationD"]
        expect([channel[2] for channel in channels_of(descriptions[1])] == kinds, channels_of(descriptions[1]))
        expect((descriptions[0].nominal_srate(), descriptions[0].type()) == (RATE_HZ, "MoCap"), descriptions[0].as_xml()[:400])
        ask(options, run, "start", "--name", "published")
        ages = [[], [], []]
        with concurrent.futures.ThreadPoolExecutor(3) as pool:
            running = [pool.submit(pulled, inlet, options.seconds, age) for inlet, age in zip(inlets, ages)]
            time.sleep(0.5 * options.seconds)
            ask(options, run, "mark", "half way <&>")
            (samples, stamps), (poses, pose_stamps), (events, event_stamps) = [one.result() for one in running]
        correction = inlets[0].time_correction(5)
        (status,) = ask(options, run, "status")["publish"]
        stopped = ask(options, run, "stop")
        events += pulled(inlets[2], 1)[0]
        description, xdf = descriptions[0], xdf_of(options, run / "published.take")
    expect(abs(correction) < 0.005, f"the clock of one machine is {correction} s off")
    expect([client["stream"] for client in status["clients"]] == [f"{rig}{end}" for end in ("", "-poses", "-events")], status)
    expect(status["protocol"] == "lsl", status)
    expect(stopped["ledger"]["closes"] and stopped["ledger"]["lost_on_link"] == 0, stopped)
    expect(events == [["take-started published"], ["mark half way <&>"], ["take-stopped published"]], events)
    for age, what in zip(ages[:2], ("positions", "poses")):
        expect_recent(age, what)
    expect(stamps[0] <= event_stamps[1] <= stamps[-1], f"{event_stamps} s, frames from {stamps[0]} to {stamps[-1]} s")
    # Every frame is there: as the recorder has it, in metres again.
    metres = (positions_mm().astype(np.float64) / 1000).astype(np.float32)
    millimetres = (metres.astype(np.float64) * 1000).astype(np.float32)
    again = (millimetres.astype(np.float64) / 1000).astype(np.float32)
    column = {name: index for index, name in enumerate(labels + renamed)}
    again = again[:, [column[name] for name in names]]
    got = np.array(samples, dtype=np.float32).reshape(len(samples), N_MARKERS, 3)
    seen = names.index(labels[0])
    row_of = {place.tobytes(): row for row, place in enumerate(again[:, seen])}
    rows = np.array([row_of[place.tobytes()] for place in got[:, seen]])
    wanted = again[rows]
    expect(((got == wanted) | (np.isnan(got) & np.isnan(wanted))).all(), "positions")
    gaps = np.diff(rows) % N_FRAMES
    missing, missed = int((gaps - 1).sum()), status["clients"][0]["frames_missed"]
    expect(gaps.min() >= 1 and missing <= missed, f"{missing} frames are missing, {missed} counted as missed")
    expect(len(got) + missing > 0.9 * RATE_HZ * options.seconds, f"{len(got)} samples")
    steps = np.diff(stamps) * RATE_HZ / gaps
    expect(steps.min() > 0.8 and steps.max() < 1.2, f"steps of {steps.min()} to {steps.max()} periods")
    turns = np.array(poses, dtype=np.float64)[:, 3:]
    turns = turns[~np.isnan(turns).any(axis=1)]
    # Those that came too late are counted, and must be few even so.
    late = min(status["poses_left_out"], 0.4 * len(got))
    expect(len(turns) > 0.9 * len(got) - late, f"{len(turns)} poses in {len(got)} frames, {status['poses_left_out']} too late")
    expect(np.abs(np.linalg.norm(turns, axis=1) - 1).max() < 1e-6, "quaternions")
    # A pose has the time of its frame, in the overlap of both readings.
    both = (pose_stamps >= stamps[0]) & (pose_stamps <= stamps[-1])
    expect(both.sum() > 0.9 * len(got) and set(pose_stamps[both]) <= set(stamps), "times of poses")
    # The take has the same frames, at the same times, and its XDF file the same description.
    stream = xdf["MoCap"]
    recorded_mm = np.array(stream["time_series"], dtype=np.float32).reshape(-1, N_MARKERS, 3)
    written = [tuple(channel[key][0] for key in ("label", "marker", "type"))
               for channel in stream["info"]["desc"][0]["channels"][0]["channel"]]
    expect(written == [channel[:3] for channel in channels_of(description)], "the descriptions of stream and file differ")
    recorded = (recorded_mm.astype(np.float64) / 1000).astype(np.float32)
    # Of the published frames, those from the first one of the take on; a row of the motion comes again after two seconds.
    start = next((k for k in range(len(got)) if (got[k, seen] == recorded[0, seen]).all()), None)
    expect(start is not None and start < N_FRAMES, "the first frame of the take was not published")
    place = np.concatenate([[0], np.cumsum(gaps[start:])])
    place = place[place < len(recorded)]
    same, taken = got[start:start + len(place)], recorded[place]
    expect(((same == taken) | (np.isnan(same) & np.isnan(taken))).all(), "the take has other positions")
    ours = np.array(stream["time_stamps"])[place]
    apart = np.abs((stamps[start:start + len(place)] - stamps[start]) - (ours - ours[0]))
    expect(len(place) > 0.8 * len(got) and apart.max() < 1e-3, f"times differ by {1e3 * apart.max()} ms")
    return f"{len(got)} frames, {len(poses)} poses, times within {1e6 * apart.max():.0f} us of the take's"


def check_service_samples(options, folder):
    """pylsl reads force plates and electrodes that the service records: the samples of the take, at their rate and times."""
    rig, run, pty = f"samples{os.getpid()}", folder / "samples", folder / "device"
    command = [options.mocapd_sim, "serve", "--generate", "jump", "--rate", f"{RATE_HZ}Hz", "--plates=960", "--emg", "2@1920",
               "--seconds", "120s", f"--pty={pty}"]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        expect(process.stdout.readline().strip(), "the simulator names no port")
        with service(options, f"serial:{pty}", run, rig):
            inlets = [inlet_of(f"{rig}-analog-{group}") for group in (0, 1)]
            described = [inlet.info(10) for inlet in inlets]
            expect([info.nominal_srate() for info in described] == [960, 1920], "rates")
            ask(options, run, "start", "--name", "samples")
            ages = [[], []]
            with concurrent.futures.ThreadPoolExecutor(2) as pool:
                pieces = list(pool.map(pulled, inlets, (3, 3), ages))
            (status,) = ask(options, run, "status")["publish"]
            lost = status["batches_left_out"] + status["frames_missed"]
            ask(options, run, "stop")
            export = [str(options.mocapd), "export", str(run / "samples.take"), "-o", str(run / "samples.npz")]
            subprocess.run(export, check=True, capture_output=True)
            archive = dict(np.load(run / "samples.npz"))
    finally:
        process.terminate()
        process.wait(10)
    counts = []
    for group, (info, (samples, stamps)) in enumerate(zip(described, pieces)):
        labels = [channel[0] for channel in channels_of(info)]
        expect(labels == [str(label) for label in archive[f"sampled_{group}_labels"]], labels)
        expect({channel[2] for channel in channels_of(info)} == {"Analog"}, channels_of(info))
        got, taken = np.array(samples, dtype=np.float32), archive[f"sampled_{group}"].astype(np.float32)
        # A plate on which somebody stands still sends the same sample again and again: the take begins at one of these.
        for first in np.flatnonzero((got == taken[0]).all(axis=1)):
            place = np.round((stamps - stamps[first]) * info.nominal_srate()).astype(int)
            inside = (place >= 0) & (place < len(taken))
            place, n = place[inside], int(inside.sum())
            if (got[inside] == taken[place]).all():
                break
        else:
            raise AssertionError(f"group {group}: the take has other samples")
        expect(n > 0.5 * len(got), f"group {group}: {n} of {len(got)} samples")
        # On a machine that stands still, batches are left out, which is counted.
        expect(place[-1] + 1 == n or lost > 0, f"group {group}: {place[-1] + 1 - n} samples are missing, and none is counted")
        times = archive[f"sampled_{group}_time_s"][place]
        apart = np.abs((stamps[inside] - stamps[first]) - (times - times[0]))
        expect(apart.max() < 1e-3, f"group {group}: times differ by {1e3 * apart.max()} ms")
        expect_recent(ages[group], f"group {group}")
        counts.append(n)
    return f"{counts[0]} and {counts[1]} samples"


def check_slow_inlet(options, folder):
    """An inlet that does not read misses what does not fit, which is counted; the other misses nothing."""
    import pylsl
    rig, run = f"slow{os.getpid()}", folder / "slow"
    with natnet_simulator(options, folder / "motion.csv") as uri, service(options, uri, run, rig):
        (found,) = pylsl.resolve_byprop("name", rig, 1, 20)
        with socket.socket() as silent:
            silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            silent.connect(("127.0.0.1", data_port_of(found)))
            # A second of samples may wait for it, and it reads none.
            request = f"LSL:streamfeed/110 {found.uid()}\r\nNative-Byte-Order: 1234\r\nValue-Size: 4\r\n"
            silent.sendall(f"{request}Max-Buffer-Length: {RATE_HZ}\r\nProtocol-Version: 110\r\n\r\n".encode())
            inlet = inlet_of(rig)
            samples, _ = pulled(inlet, 3)
            deadline = time.monotonic() + 60
            while True:
                (status,) = ask(options, run, "status")["publish"]
                missed = {client["address"]: client["frames_missed"] for client in status["clients"]}
                slow = missed.pop(f"127.0.0.1:{silent.getsockname()[1]}")
                more, _ = pulled(inlet, 1)
                samples += more
                if slow > status["frames_left_out"]:
                    break
                expect(time.monotonic() < deadline, status)
            # What the publisher itself could not take in time, on a busy machine, all miss.
            expect(max(missed.values()) <= status["frames_left_out"], status)
    return f"{slow} samples missed by the one that does not read, {status['frames_left_out']} of {len(samples)} by the other"


def data_port_of(found):
    """The TCP port of a stream's data."""
    text = found.as_xml()
    return int(text.split("<v4data_port>")[1].split("<")[0])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--seconds", type=float, default=20, help="how long our stream is read")
    parser.add_argument("--only", help="run checks whose name contains this")
    options = parser.parse_args()
    options.mocapd, options.mocapd_sim = options.mocapd.resolve(), options.mocapd_sim.resolve()
    checks = [check_outlet, check_same_stream, check_units, check_eeg_and_events, check_irregular, check_outage,
              check_others_go_on, check_names,
              check_convention, check_service, check_service_samples, check_slow_inlet]
    checks = [check for check in checks if options.only is None or options.only in check.__name__]
    passed = 0
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        configuration = folder / "lsl.cfg"
        configuration.write_text(CONFIGURATION)
        os.environ["LSLAPICFG"] = str(configuration)
        write_motion(folder / "motion.csv")
        with concurrent.futures.ThreadPoolExecutor(len(checks)) as pool:
            running = {pool.submit(check, options, folder): check for check in checks}
            for done in concurrent.futures.as_completed(running):
                name = running[done].__name__.removeprefix("check_")
                try:
                    print(f"ok   {name}: {done.result()}", flush=True)
                    passed += 1
                except Exception as problem:  # any failure is this check's, the others still count
                    print(f"FAIL {name}: {type(problem).__name__}: {problem}", flush=True)
    print(f"{passed} passed, {len(checks) - passed} failed")
    sys.exit(passed != len(checks))


if __name__ == "__main__":
    if len(sys.argv) > 3 and sys.argv[1] == "--publish":
        publish(sys.argv[2], sys.argv[3], sys.argv[4:])
    else:
        main()
