"""The state of the mock: takes, events and metrics that change as those of a service. Nothing is recorded."""

import math
import random
import secrets
import struct
import threading
import time
import uuid

from mock_body import Body

#: Faults: `lose_responses` executes that many commands without a response; `cut_streams` ends the streams opened before
#: that time.
FAULTS = {"presence": "streaming", "obstacle": None, "lossy": False, "frozen": False, "delay_s": 0.0, "refuse": None,
          "free_bytes": 412_000_000_000, "lose_responses": 0, "cut_streams": 0.0, "refuse_windows": None,
          "refuse_events": None}


class Refused(Exception):
    def __init__(self, kind, message):
        super().__init__(message)
        self.kind, self.message = kind, message


def sampled_groups():
    """Two force plates, and eight electrodes."""
    plates = [{"name": f"{name}{plate}", "unit": "N" if name[0] == "F" else "Nm", "full_scale": [-8192.0, 8191.75]}
              for plate in (1, 2) for name in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")]
    electrodes = [{"name": f"EMG{i + 1}", "unit": "V", "full_scale": [-5e-3, 4.99985e-3]} for i in range(8)]
    return [{"number": 1, "rate_hz": 1000.0, "channels": plates}, {"number": 2, "rate_hz": 1000.0, "channels": electrodes}]


BODIES = ["wand", "pelvis", ""]


def body_values(t):
    """The poses of the bodies at a time: nine numbers each. The second is lost in every other second."""
    half = 0.4 * t
    poses = [(0.0, 0.25, 300 * math.cos(t), 300 * math.sin(t), 1200.0, math.cos(half), 0.0, 0.0, math.sin(half)),
             (0.0, 0.5, 0.0, 0.0, 950.0, math.cos(half), math.sin(half), 0.0, 0.0),
             (0.0, math.nan, -600.0, 400.0, 300.0, 1.0, 0.0, 0.0, 0.0)]
    if int(t) % 2:
        poses[1] = (1.0,) + (math.nan,) * 8
    return [value for pose in poses for value in pose]


class Rig:
    """Every method is called with `lock` held."""

    def __init__(self, markers, rate_hz, seed, scenario, sampled=False, bodies=False):
        self.body_names = BODIES if bodies else []
        self.groups = sampled_groups() if sampled else []
        self.columns_sent = 0
        self.lock = threading.Condition()
        self.rate_hz, self.born = rate_hz, time.time()
        self.body = Body(markers, seed, strays=markers // 12)
        self.draw = random.Random(seed)
        self.state, self.failure, self.armed_at, self.take = "idle", None, None, None
        self.lost, self.causes, self.outages, self.last_step = 0, [0, 0, 0, 0], 0, time.time()
        self.faults = dict(FAULTS)
        self.gone_at, self.missed_s = None, 0.0
        self.session, self.cookie = secrets.token_hex(4), secrets.token_hex(8)
        self.events, self.replies, self.requests = [], {}, []
        self.trash, self.pending, self.missed = [], None, None
        now = int(time.time() * 1000)
        self.takes = [self.new_take(f"jump-{n:03}", now - (6 - n) * 420_000, 8.4 + 3 * n, health) for n, health in
                      [(5, "unknown"), (4, "complete"), (3, "lossy"), (2, "cut off"), (1, "complete")]]
        self.takes[1]["notes"] = {"rating": "good", "text": "left shoe\nbest of the series", "changed_unix_ms": now, "problem": None}
        self.takes[2]["notes"] = {"rating": "bad", "text": "a marker fell off", "changed_unix_ms": now, "problem": None}
        self.takes[4]["notes"] = {"rating": "none", "text": "", "changed_unix_ms": 0,
                                  "problem": "jump-001.notes.json belongs to another take, or this one has changed since; it is left as it is"}
        with self.lock:
            self._begin(scenario)

    def _begin(self, scenario):
        self.event("state", "service started")
        if scenario != "idle":
            self.arm()
        if scenario == "lossy":
            self.faults["lossy"] = True
        elif scenario == "absent":
            self.disarm()
            self.faults.update(presence="absent", obstacle="/dev/ttyUSB0 does not exist: is the device plugged in?")
        elif scenario == "failed":
            self.fail("the disk failed while jump-006 was written (EIO): the take contains 41.5 s; "
                      "check the disk, then arm again")
        elif scenario in ("recording", "recording-absent"):
            self.start({"name": "jump-006"})
        if scenario in ("armed-absent", "recording-absent"):
            self.set_faults({"presence": "absent", "obstacle":
                             "the device is absent: plug it in or switch it on; recording continues by itself"})
        elif scenario == "silent":
            self.set_faults({"presence": "silent"})

    def set_faults(self, faults):
        """Sets faults; an outage begins when the device goes absent or silent, and ends when it is back."""
        self.faults.update(faults)
        is_gone = self.armed_at is not None and self.faults["presence"] != "streaming"
        if is_gone and self.gone_at is None:
            self.gone_at = time.time()
        elif not is_gone and self.gone_at is not None:
            self.missed_s += time.time() - self.gone_at
            self.outages, self.gone_at = self.outages + 1, None

    def outage(self):
        if self.gone_at is None:
            return None
        seconds = time.time() - self.gone_at
        ends = max(0.0, 60.0 - seconds) if self.faults["presence"] == "absent" else None
        return {"seconds": seconds, "frames": int(seconds * self.rate_hz), "ends_in_s": ends}

    def event(self, kind, message):
        self.events.append({"number": len(self.events) + 1, "unix_ms": int(time.time() * 1000), "kind": kind,
                            "message": message, "state": self.state, "take": self.take and self.take["name"]})
        self.lock.notify_all()

    def fail(self, why):
        self.state, self.failure, self.take = "failed", why, None
        self.event("failure", why)

    def new_take(self, name, modified, seconds, health):
        known = health not in ("unknown", "unreadable")
        return {"name": name, "bytes": int(seconds * 61_000 * len(self.body.labels) / 200), "is_open": False,
                "modified_unix_ms": modified, "health": health, "seconds": seconds if known else 0.0,
                "markers": len(self.body.labels) if known else 0, "take_id": uuid.uuid4().hex if known else "", "notes": None}

    def find(self, name):
        for take in self.takes:
            if take["name"] == name:
                return take
        raise Refused("not_found", f"there is no take called {name}")

    def check_free(self, name):
        if any(take["name"] == name for take in self.takes):
            raise Refused("exists", f"a take called {name}, or notes for it, exist: choose another name")

    def edit_notes(self, name, body):
        take = self.find(name)
        before = take["notes"] or {"rating": "none", "text": ""}
        if before.get("problem"):
            raise Refused("conflict", before["problem"])
        take["notes"] = {"rating": body.get("rating", before["rating"]), "text": body.get("text", before["text"]),
                         "changed_unix_ms": int(time.time() * 1000), "problem": None}
        self.event("take-changed", f"{name}: rating {take['notes']['rating']}")
        return take["notes"]

    def rename(self, name, body):
        take = self.find(name)
        if "/" in body["to"]:
            raise Refused("invalid", "a take name cannot contain '/', as it is a file name")
        self.check_free(body["to"])
        take["name"] = body["to"]
        self.event("take-changed", f"the take {name} is now {body['to']}")
        return {"name": body["to"], "path": f"/var/lib/mocapd/{body['to']}.take", "remarks": []}

    def trash_take(self, name, _body):
        take, now = self.find(name), int(time.time() * 1000)
        self.takes.remove(take)
        trashed = {"id": f"{now}.{name}", "name": name, "bytes": take["bytes"], "trashed_unix_ms": now,
                   "removed_unix_ms": now + 30 * 86_400_000}
        self.trash.insert(0, (trashed, take))
        self.event("take-changed", f"the take {name} was moved to the trash")
        return trashed

    def restore(self, key, body):
        for entry in self.trash:
            trashed, take = entry
            if key in (trashed["id"], trashed["name"]):
                self.check_free(body.get("to") or take["name"])
                self.trash.remove(entry)
                self.takes.insert(0, take)
                self.event("take-changed", f"the take {take['name']} was restored from the trash")
                return {"name": take["name"], "path": f"/var/lib/mocapd/{take['name']}.take", "remarks": []}
        raise Refused("not_found", f"there is no take {key} in the trash")

    def cancel(self, _body):
        if self.pending is None:
            raise Refused("conflict", "no start is waiting: there is nothing to cancel")
        pending, self.pending = self.pending, None
        return pending

    def step(self):
        """Adds the frames lost since the last step."""
        now = time.time()
        n_frames = (now - self.last_step) * self.rate_hz
        self.last_step = now
        if self.faults["lossy"] and self.armed_at:
            for cause, share in enumerate([0.012, 0.002, 0.004, 0.0]):
                n = int(n_frames * share * self.draw.uniform(0, 2) + self.draw.random())
                self.causes[cause] += n
                self.lost += n

    def arm(self, _body=None):
        if self.faults["presence"] == "absent":
            raise Refused("device", "the device is absent: " + self.faults["obstacle"])
        if self.state in ("idle", "failed"):
            self.state, self.failure, self.armed_at = "armed", None, time.time()
            self.lost, self.causes = 0, [0, 0, 0, 0]
            self.event("state", "armed: 10 s of pre-roll")

    def disarm(self, _body=None):
        if self.state == "recording":
            raise Refused("conflict", "a take is being recorded: stop it first")
        self.state, self.failure, self.armed_at, self.gone_at = "idle", None, None, None
        self.event("state", "idle")

    def start(self, body):
        if self.state == "recording":
            raise Refused("conflict", f"{self.take['name']} is being recorded: stop it first")
        if body.get("at"):
            if self.pending:
                raise Refused("conflict", f"a start already waits for {self.pending['at']}: cancel it first")
            self.pending = {"at_unix_ms": int(time.time() * 1000), "at": f"2026-11-29T{body['at']}+01:00", "name": body.get("name"),
                            "remarks": []}
            self.event("state", f"a take will be started at {self.pending['at']}")
            return self.pending
        parts = [body[key] for key in ("subject", "session", "trial") if body.get(key)]
        counted = f"{'_'.join(parts)}_{len(self.takes):03}" if parts else None
        name = body.get("name") or counted or f"take-{len(self.takes) + 1:03}"
        if any(take["name"] == name for take in self.takes):
            raise Refused("exists", f"a take called {name} exists: choose another name")
        self.arm()
        held = min(10.0, time.time() - self.armed_at)
        self.state = "recording"
        self.take = {"take_id": uuid.uuid4().hex, "name": name, "path": f"/var/lib/mocapd/{name}.take", "held": held,
                     "started": time.time(), "wanted": body.get("seconds")}
        self.causes = [0, 0, 0, 0]
        self.event("take-started", f"{name} starts {held:.2f} s before the request")
        remarks = [f"the pre-roll is {held:.1f} s long: no more was held"] if held < 9.9 else []
        return {**{key: self.take[key] for key in ("take_id", "name", "path")}, "remarks": remarks,
                "first_frame": {"device_ticks": 1, "arrival_ns": 1, "before_request_s": held}}

    def stop(self, _body):
        if self.state != "recording":
            raise Refused("conflict", "no take is being recorded")
        status = self.take_status()
        self.takes.insert(0, self.new_take(status["name"], int(time.time() * 1000), status["seconds"],
                                        "lossy" if sum(self.causes) else "complete"))
        self.state, self.take = "armed", None
        self.event("take-stopped", f"{status['name']}: {status['seconds']:.1f} s, stopped")
        return {**{key: status[key] for key in ("take_id", "name", "path", "rows", "seconds", "bytes")},
                "ending": "stopped", "ledger": {**status["ledger"], "finished": True}}

    def mark(self, body):
        if self.state != "recording":
            raise Refused("conflict", "no take is being recorded: there is nothing to mark")
        self.event("mark", body.get("text") or "mark")
        return {"row": self.take_status()["rows"]}

    def save_last(self, body):
        if self.armed_at is None:
            raise Refused("conflict", "not armed: the pre-roll is empty")
        wanted = body.get("seconds", 10.0)
        seconds = min(wanted, 10.0, time.time() - self.armed_at)
        name = body.get("name") or f"last-{len(self.takes) + 1:03}"
        take = self.new_take(name, int(time.time() * 1000), seconds, "complete")
        self.takes.insert(0, take)
        self.event("take-saved", f"{name}: the last {seconds:.1f} s")
        return {"take_id": take["take_id"], "name": name, "path": f"/var/lib/mocapd/{name}.take",
                "rows": int(seconds * self.rate_hz), "seconds": seconds, "bytes": take["bytes"], "ending": "saved",
                "short_by_s": wanted - seconds if "seconds" in body else 0.0, "ledger": self.ledger(int(seconds * self.rate_hz)),
                "remarks": [f"only {seconds:.1f} s of the requested {wanted:.1f} s were held"]
                if "seconds" in body and wanted > seconds + 0.1 else []}

    def ledger(self, rows):
        link, device, ring, other = self.causes
        announced = (rows - sum(self.causes)) * len(self.body.labels)
        occluded = int(announced * 0.031)
        return {"finished": False, "closes": True, "frames_sent": rows, "recorded": rows - sum(self.causes),
                "lost_on_link": link, "dropped_by_device": device, "lost_ring_full": ring, "lost_other": other,
                "duplicates": 0, "unknown_after_disconnect": 0, "samples_announced": announced,
                "samples_present": announced - occluded, "samples_occluded": occluded, "samples_not_finite": 0,
                "markers_dropped": 0, "contradictions": []}

    def take_status(self):
        take = self.take
        if take is None:
            return None
        seconds = (self.gone_at or time.time()) - take["started"] + take["held"]
        rows = int(seconds * self.rate_hz)
        raw = rows * len(self.body.labels) * 12
        return {"take_id": take["take_id"], "name": take["name"], "path": take["path"],
                "started_unix_ms": int(take["started"] * 1000), "rows": rows, "seconds": seconds,
                "bytes": raw // 21, "durable_bytes": max(0, raw // 21 - 30_000), "ratio": 21.0,
                "max_error_mm": 0.499, "ledger": self.ledger(rows), "wanted_s": take["wanted"],
                "sample_ledger": self.sample_ledger(seconds)}

    def sample_ledger(self, seconds):
        """Of the second group a batch was lost on the link."""
        if not self.groups:
            return None
        groups = []
        for index, group in enumerate(self.groups):
            taken, lost = int(seconds * group["rate_hz"]), 20 * index
            groups.append({"group": group["number"], "taken": taken, "stored": taken - lost, "lost_on_link": lost,
                           "dropped_by_device": 0, "lost_ring_full": 0, "lost_other": 0, "unknown_after_disconnect": 0,
                           "duplicates": 0, "jumps": 0})
        return {"finished": False, "closes": True, "batches_refused": 0, "groups": groups}

    def columns(self, t):
        """The messages of the sampled channels since the last call: the second electrode is clipped in every second."""
        if not self.groups:
            return []
        due = max(self.columns_sent + 1, int(t * 20))
        number, self.columns_sent = self.columns_sent, due
        messages = []
        for index, group in enumerate(self.groups):
            for column in range(max(number, due - 3), due):
                ranges = []
                for channel in range(len(group["channels"])):
                    if index == 0:
                        up = 700.0 * max(0.0, math.sin(column / 20 + channel))
                        ranges += [up - 10.0, up + 10.0]
                    else:
                        size = 5e-3 if channel == 1 and column % 20 == 0 else 1e-3 * abs(math.sin(column / 13 + channel))
                        ranges += [-size, size]
                messages.append(struct.pack(f"<BBxxQI{len(ranges)}f", 4, index, column * 50, 50, *ranges))
        return messages

    def status(self):
        self.step()
        faults, now, is_armed = self.faults, time.time(), self.armed_at is not None
        is_present = faults["presence"] != "absent"
        # The identity of an armed device stays known while it is absent.
        is_known = is_present or is_armed
        held = min(10.0, now - self.armed_at) if is_armed else 0.0
        wobble = self.draw.gauss(0, 0.02)
        measured = (self.rate_hz * (0.982 if faults["lossy"] else 1) + wobble) if is_armed and faults["presence"] == "streaming" else 0.0
        return {
            "rig": "jump lab", "state": self.state, "failure": self.failure, "software": "mocapd mock",
            "uptime_s": now - self.born,
            "device": {"uri": "serial:/dev/ttyUSB0", "presence": "present" if is_present and not is_armed else faults["presence"],
                       "model": "DVMC-8820" if is_known else "", "serial": "SIM-0001" if is_known else "",
                       "firmware": "1.4" if is_known else "", "driver": "dvmc", "rate_hz": self.rate_hz if is_known else 0.0,
                       "markers": len(self.body.labels) if is_known else 0, "obstacle": faults["obstacle"],
                       "outages": self.outages, "is_awaited": not is_present and is_armed, "outage": self.outage()},
            "input": {"frames": int(((self.gone_at or now) - self.armed_at - self.missed_s) * self.rate_hz) if is_armed else 0,
                      "lost": self.lost,
                      "measured_hz": measured, "ring_fill": (0.31 if faults["lossy"] else 0.02) if is_armed else 0.0,
                      "ring_latency_p99_us": 46 if is_armed else 0, "jitter_p99_us": 212 if is_armed else 0,
                      "drift_ppm": 11.8, "cpu_cores": 0.07 if is_armed else 0.0},
            "pre_roll": {"wanted_s": 10.0, "held_s": held, "held_bytes": int(held * 61_000), "is_cut": False},
            "pending_start": self.pending, "missed_start": self.missed, "names": None,
            "take": self.take_status(), "last_take": self.takes[0] if self.takes else None,
            "disk": {"directory": "/var/lib/mocapd", "free_bytes": faults["free_bytes"],
                     "keep_free_bytes": 268_435_456, "left_s": int(faults["free_bytes"] / 12_000) if is_armed else None},
        }

    def quality(self):
        runs_s = time.time() - self.armed_at if self.armed_at else 0.0
        rows = []
        for slot, (label, (period, _, gap)) in enumerate(zip(self.body.labels, self.body.occlusions)):
            rows.append({"label": label, "labelled": self.body.labelled[slot],
                         "visible": 1 - gap / period if runs_s else 0.0, "gaps": int(runs_s / period) if gap else 0,
                         "longest_gap_s": gap if runs_s > period else 0.0,
                         "noise_mm": None if slot % 17 == 5 else 0.08 + 0.02 * (slot % 5),
                         "swaps_suspected": 2 if slot % 61 == 7 else 0})
        return rows
