#!/usr/bin/env bash
# Sionna RT 2.2.0: a building whose faces do not share vertices diffracts nothing, without a word.
#
# Guess: the same closed box diffracts the same, whether its twelve triangles share eight corners or
# every face brings corners of its own, as flat-shaded exports and Mitsuba's own shape "cube" do.
# If not, a warning says that no edge was found.
#
# Seen: behind the corner the box of 8 shared vertices gives one diffracted path. The same box with
# 24 vertices, and Mitsuba's "cube", give none, and nothing is printed. Wedges are found by vertex
# numbers, not by place, so weld the vertices of a mesh before it goes into a scene.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" --disable-pip-version-check install --quiet \
  "sionna-rt==2.2.0" "mitsuba==3.9.1" "drjit==1.5.0" "karellen-llvm-core==23.1.4.post8"
cat > "$folder/box.py" <<'PY'
import ctypes
import importlib.metadata as packages
import os
import pathlib
import tempfile

import numpy as np

# the compiler of the wheel, with the C++ library that it was built with
files = [str(f.locate()) for f in packages.files("karellen-llvm-core")]
for name in ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1"):
    for file in (f for f in files if f.endswith("/" + name)):
        ctypes.CDLL(file)
os.environ["DRJIT_LIBLLVM_PATH"] = sorted(f for f in files if "/libLLVM" in f and ".so" in f)[0]

import mitsuba as mi

mi.set_variant("llvm_ad_mono_polarized")
import sionna.rt as rt

SIDE_M, HALF_HEIGHT_M = 40.0, 50.0


def ply(shared):
    """The box as a PLY file, with 8 corners or with 4 for each face."""
    x, y, z = np.meshgrid(
        [0, SIDE_M], [-SIDE_M, 0], [-HALF_HEIGHT_M, HALF_HEIGHT_M], indexing="ij")
    corners = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    if not shared:
        corners = np.concatenate([corners[list(face)] for face in faces])
        faces = [tuple(range(4 * k, 4 * k + 4)) for k in range(len(faces))]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(corners)}",
             *(f"property float {axis}" for axis in "xyz"), f"element face {len(triangles)}",
             "property list uchar int vertex_indices", "end_header",
             *(" ".join(map(str, corner)) for corner in corners),
             *(f"3 {a} {b} {c}" for a, b, c in triangles)]
    file = pathlib.Path(tempfile.mkdtemp()) / "box.ply"
    file.write_text("\n".join(lines) + "\n")
    return str(file)


def diffracted_paths(kind):
    scene = rt.load_scene()
    scene.frequency = 5e9
    array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    scene.tx_array = scene.rx_array = array
    stone = rt.ITURadioMaterial("stone", "concrete", thickness=0.3)
    if kind == "Mitsuba's cube":
        place = mi.ScalarTransform4f().translate([SIDE_M / 2, -SIDE_M / 2, 0.0])
        place = place.scale([SIDE_M / 2, SIDE_M / 2, HALF_HEIGHT_M])
        mesh = {"mi_mesh": mi.load_dict({"type": "cube", "to_world": place})}
    else:
        mesh = {"fname": ply(shared=kind == "shared corners")}
    wall = rt.SceneObject(name="wall", radio_material=stone, **mesh)
    scene.edit(add=[wall])
    scene.add(rt.Transmitter("tx", position=mi.Point3f(10.0, 20.0, 0.0)))
    scene.add(rt.Receiver("rx", position=mi.Point3f(-15.0, -20.0, 0.0)))
    paths = rt.PathSolver()(
        scene, max_depth=1, los=False, specular_reflection=False, refraction=False,
        diffraction=True, samples_per_src=200_000, seed=1,
    )
    return wall.mi_mesh.vertex_count(), int((paths.interactions.numpy() == 8).sum())


print("sionna-rt", packages.version("sionna-rt"), "mitsuba", packages.version("mitsuba"))
for kind, expected in (("shared corners", 1), ("corners per face", 0), ("Mitsuba's cube", 0)):
    vertices, paths = diffracted_paths(kind)
    print(f"{kind}: {vertices} vertices, {paths} diffracted paths")
    assert paths == expected, "the finding no longer holds"
print("the finding holds")
PY
TMPDIR="$folder" "$folder/venv/bin/python" "$folder/box.py"
