"""The subject in the page: skeleton of a scan, and face of a photograph, under the markers of a simulated device."""

import contextlib
import json
import subprocess
import tempfile
import time
from pathlib import Path

from checks_service import Rig

ROOT = Path(__file__).resolve().parents[2]
#: The public take with markers on a face, and the mapping of these markers to the face.
SINGING = "face_singing_38m_100hz_malformed_header.c3d"
MAPPING = ROOT / "subject" / "face" / "data" / "singing-face-mapping.json"
#: Mean distance of the markers that hardly move against the skull: the wireframe is of another person, a drawn
#: portrait, whose temples are up to 31 mm off.
WEIGHT_MIN, OFF_MM_MAX = 0.5, 15
#: Time until the camera has settled.
SETTLES_S = 3
#: Distances of vertices from their markers, by label, computed in the page.
OFF = """
    const placed = mocapdMotion.placedFace();
    if (!placed) return null;
    return arguments[0].map(([label, at]) => {
        const slot = mocapdMotion.labels.indexOf(label);
        const off = [0, 1, 2].map((i) => placed[3 * at + i] - mocapdMotion.last[3 * slot + i]);
        return Math.hypot(...off);
    });"""


def checks(mocapd, mocapd_sim, drawn_subject, takes):
    """The checks, each with its name. `drawn_subject` is a folder with a scan and a portrait."""
    def body(browser, log):
        with tempfile.TemporaryDirectory(prefix="subject-") as folder:
            a_body(browser, log, mocapd, mocapd_sim, drawn_subject, Path(folder))

    def face(browser, log):
        with tempfile.TemporaryDirectory(prefix="subject-") as folder:
            a_face(browser, log, mocapd, mocapd_sim, drawn_subject, takes / SINGING, Path(folder))

    found = [("the subject: limbs that deviate from the scan are highlighted", body)]
    if takes is None:
        print("skipped: the subject's face (no recorded takes: --takes)")
    else:
        found.append(("the subject: a face under the markers of a singer", face))
    return found


def prepared(mocapd, *args):
    subprocess.run([mocapd, "subject", *args], check=True, capture_output=True)


@contextlib.contextmanager
def open_page(browser, mocapd, mocapd_sim, motion, subject):
    """The page of an armed service with a subject; browser errors fail the check."""
    rig = Rig(mocapd, mocapd_sim, motion=motion, subject=subject)
    try:
        browser.open(rig.url)
        browser.wait_state("armed", 20)
        yield
        assert browser.errors() == []
    except AssertionError as error:
        raise AssertionError(f"{error}\n{rig.logs()}") from error
    finally:
        browser.open("about:blank")
        rig.close()


def a_body(browser, log, mocapd, mocapd_sim, drawn_subject, folder):
    skeleton = folder / "skeleton.json"
    prepared(mocapd, "body", drawn_subject / "scan.obj", "-o", skeleton)
    lengths = {bone["name"]: bone["length_mm"] for bone in json.loads(skeleton.read_text())["bones"]}
    motion = ("--generate", "jump:3", "--seconds", 20, "--markers", 15, "--rate", 120)
    subject = {"name": "nobody", "skeleton": skeleton}
    with open_page(browser, mocapd, mocapd_sim, motion, subject):
        browser.wait("the skeleton", "return mocapdMotion.limbs.length > 0")
        limbs = browser.js("return mocapdMotion.limbs.map((limb) => limb.length_mm)")
        assert len(limbs) >= 8 and all(min(abs(mm - of) for of in lengths.values()) < 0.1 for mm in limbs), (limbs, lengths)
        # The device plays another body than the scanned one.
        browser.wait("limbs of another length", "return mocapdMotion.deviatingLimbs().length > 0")
        log(f"{len(limbs)} limbs, {browser.js('return mocapdMotion.deviatingLimbs().length')} of another length")
        time.sleep(SETTLES_S)
        browser.picture("subject-body")


def a_face(browser, log, mocapd, mocapd_sim, drawn_subject, take, folder):
    face = folder / "face.json"
    prepared(mocapd, "face", drawn_subject / "portrait.png", "-o", face)
    subject = {"name": "singer", "face": face, "face_markers": MAPPING}
    # Only markers mapped to a vertex number: the page knows only vertices.
    markers = [marker for marker in json.loads(MAPPING.read_text())["markers"]
               if isinstance(marker["at"], int) and marker["weight"] >= WEIGHT_MIN]
    with open_page(browser, mocapd, mocapd_sim, (take,), subject):
        browser.wait("the face", "return mocapdMotion.placedFace() !== null")
        off_mm = browser.js(OFF, [[marker["label"], marker["at"]] for marker in markers])
        mean_mm = sum(off_mm) / len(off_mm)
        log(f"{len(off_mm)} vertices are {mean_mm:.1f} mm from their markers, at most {max(off_mm):.1f}")
        assert len(off_mm) >= 8 and mean_mm < OFF_MM_MAX, off_mm
        time.sleep(SETTLES_S)
        browser.picture("subject-face")
