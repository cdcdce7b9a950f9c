"""ORB-SLAM3 beside our modes, by pyorbslam3 (GPL-3.0) in an environment of its own.

python -m venv orb && orb/bin/pip install pyorbslam3 opencv-python-headless pyyaml
fvslam compare PATH --system ORB-SLAM3='orb/bin/python orbslam3.py {images} {times} {camera} {out}'
"""

import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pyorbslam3
import yaml

images, times, camera, out = map(Path, sys.argv[1:])
known = yaml.safe_load(camera.read_text())
fx, _, cx, _, fy, cy, *_ = known["camera_matrix"]
settings = {"Camera.width": known["image_width"], "Camera.height": known["image_height"], "Camera.RGB": 1}
settings |= {"Camera.fps": round(known["rate"]), "Camera1.fx": fx, "Camera1.fy": fy, "Camera1.cx": cx, "Camera1.cy": cy}
extractor = {"nFeatures": 2000, "scaleFactor": 1.2, "nLevels": 8, "iniThFAST": 20, "minThFAST": 7}
viewer = "KeyFrameSize KeyFrameLineWidth GraphLineWidth PointSize CameraSize CameraLineWidth ViewpointX ViewpointY"
settings |= {f"ORBextractor.{name}": value for name, value in extractor.items()}
settings |= {f"Viewer.{name}": 1.0 for name in f"{viewer} ViewpointZ ViewpointF".split()}
file, head = out.with_suffix(".yaml"), '%YAML:1.0\n---\nFile.version: "1.0"\nCamera.type: "PinHole"\n'
file.write_text(head + "".join(f"{name}: {value}\n" for name, value in settings.items()))
maps, stamps = [[]], [float(line) for line in times.read_text().split()]
with pyorbslam3.Slam(pyorbslam3.vocabulary_path(), file, pyorbslam3.Sensor.MONOCULAR) as slam:
    begin = time.monotonic() - stamps[0]
    for path, stamp in zip(sorted(images.iterdir()), stamps, strict=True):
        time.sleep(max(0.0, begin + stamp - time.monotonic()))  # it maps in a thread: images come as from a camera
        result = slam.track_monocular(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), stamp)
        if result.ok:  # otherwise the pose may be the identity
            half = cv2.Rodrigues(np.asarray(result.pose_wc[:3, :3], float))[0].ravel() / 2
            quaternion = [*(half * np.sinc(np.linalg.norm(half) / np.pi)), np.cos(np.linalg.norm(half))]
            maps[-1].append(" ".join(map(str, (stamp, *result.pose_wc[:3, 3], *quaternion))) + "\n")
        elif maps[-1] and result.state == pyorbslam3.TrackingState.NOT_INITIALIZED:
            maps.append([])  # a new map has a world of its own: the longest one counts
out.write_text("".join(max(maps, key=len)))
