#!/usr/bin/env bash
# DeepMIMO 4.0.5: a path-loss file of Wireless InSite with exponents is read with shifted columns.
#
# Guess: a row "number x y z distance loss" gives the same place and loss whether its numbers are
# written 100.0 or 1.0e+02, as the same values.
#
# Seen: the reader splits each number at its exponent. Of the row 1  1.0e+02  2.0e+02  1.5  3.0e+02
# 9.1e+01 it makes x = 1, y = 2, z = 2 and a loss of 1.5 dB, without a word; it should be x = 100 m,
# y = 200 m, z = 1.5 m and 91 dB.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" --disable-pip-version-check install --quiet "deepmimo==4.0.5"
cat > "$folder/read.py" <<'PY'
import importlib.metadata
import importlib.util
import pathlib
import sys

import numpy as np

print("deepmimo", importlib.metadata.version("deepmimo"))
# the one module, since its package asks for extras that do not matter here
home = pathlib.Path(importlib.util.find_spec("deepmimo").origin).parent
file = home / "converters" / "wireless_insite" / "p2m_parser.py"
spec = importlib.util.spec_from_file_location("p2m_parser", file)
parser = importlib.util.module_from_spec(spec)
spec.loader.exec_module(parser)
rows = {
    "plain": "1 100.0 200.0 1.5 300.0 91.0",
    "exponents": "1  1.0e+02  2.0e+02  1.5  3.0e+02  9.1e+01",
}
found = {}
for name, row in rows.items():
    path = pathlib.Path(sys.argv[1]) / f"{name}.pl.t001_01.r002.p2m"
    path.write_text(f"# Receiver  X(m)  Y(m)  Z(m)  Distance(m)  Path loss(dB)\n{row}\n")
    place, distance, loss = parser.read_pl_p2m_file(str(path))
    found[name] = [*place[0], loss[0, 0]]
    print(f"{name}: x, y, z, loss = {[float(v) for v in found[name]]}")
assert np.allclose(found["plain"], [100, 200, 1.5, 91]), found
assert not np.allclose(found["exponents"], found["plain"]), "mended"
PY
"$folder/venv/bin/python" "$folder/read.py" "$folder"
