"""Maps of the flight for Google Earth (KML), navigation (GPX) and GIS (GeoJSON): WGS84, in degrees and metres.

Altitudes are above what the altitude of the fixes, or of the origin, is above.
"""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

from fvslam_graph.core.files import one_line
from fvslam_graph.runs.export.georeference import Georeference
from fvslam_graph.runs.export.poses import ExportedPoses

KML, GPX = "http://www.opengis.net/kml/2.2", "http://www.topografix.com/GPX/1/1"


def write_kml(path: Path, poses: ExportedPoses, place: Georeference) -> None:
    """Write the path as a line. KML has no covariances."""
    ElementTree.register_namespace("", KML)
    kml = ElementTree.Element(f"{{{KML}}}kml")
    placemark = _add(_add(kml, KML, "Document"), KML, "Placemark")
    _add(placemark, KML, "name", one_line(poses.run.name))
    line = _add(placemark, KML, "LineString")
    _add(line, KML, "altitudeMode", "absolute")
    places = place.geodetic(poses.trajectory.positions)
    points = (f"{longitude:.15f},{latitude:.15f},{up:.9f}" for latitude, longitude, up in places)
    _add(line, KML, "coordinates", " ".join(points))
    _write(path, kml)


def write_gpx(path: Path, poses: ExportedPoses, place: Georeference) -> None:
    """Write the path as a track, with times where stamps count from 1970. GPX has no covariances."""
    ElementTree.register_namespace("", GPX)
    gpx = ElementTree.Element(f"{{{GPX}}}gpx", version="1.1", creator="fvslam_graph")
    track = _add(gpx, GPX, "trk")
    _add(track, GPX, "name", one_line(poses.run.name))
    segment = _add(track, GPX, "trkseg")
    times = poses.times
    places = place.geodetic(poses.trajectory.positions)
    for (latitude, longitude, up), time in zip(places, times, strict=True):
        point = _add(segment, GPX, "trkpt")
        point.attrib |= {"lat": f"{latitude:.15f}", "lon": f"{longitude:.15f}"}
        _add(point, GPX, "ele", f"{up:.9f}")
        if time is not None:
            _add(point, GPX, "time", time)
    _write(path, gpx)


def write_geojson(path: Path, poses: ExportedPoses, place: Georeference) -> None:
    """Write the path as a line, then a point a frame, which has the covariance (3, 3) of east, north, up in m^2."""
    places = place.geodetic(poses.trajectory.positions)[:, [1, 0, 2]].tolist()  # longitude first
    covariances = [None] * len(places)
    if (fixed := poses.fixed_axes_covariances) is not None:
        covariances = place.covariances(fixed[:, :3, :3]).tolist()
    times = poses.times
    features = [_feature("LineString", places, {"name": one_line(poses.run.name)})]
    for frame, stamp, time, status, point, covariance in zip(
        poses.frames.tolist(), poses.trajectory.stamps, times, poses.statuses, places, covariances, strict=True
    ):
        facts = {"frame": frame, "stamp": float(stamp), "time": time, "status": status, "covariance_enu": covariance}
        features.append(_feature("Point", point, facts))
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False) + "\n")


def _feature(kind: str, coordinates: object, properties: dict[str, object]) -> dict[str, object]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _add(parent: ElementTree.Element, namespace: str, name: str, text: str | None = None) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, f"{{{namespace}}}{name}")
    element.text = text
    return element


def _write(path: Path, root: ElementTree.Element) -> None:
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
