#!/usr/bin/env bash
# DeepMIMO 4.0.5: compute_pathloss(coherent=False) adds amplitudes in phase, not powers.
#
# Guess: two paths of -100 dB each, summed without coherence, give a path loss of 97 dB: powers add.
# The coherent sum lies anywhere from 94 dB (in phase) to no power at all, by the phases.
#
# Seen: coherent=False gives 94 dB, the most that any phases allow; with n equal paths it is
# 10 log10(n) dB too little loss, 10 dB for ten paths. It is the square of the sum of amplitudes,
# with the phases left out.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" --disable-pip-version-check install --quiet "deepmimo==4.0.5"
cat > "$folder/sum.py" <<'PY'
import importlib.metadata

import numpy as np
from deepmimo.datasets.dataset import Dataset

print("deepmimo", importlib.metadata.version("deepmimo"))
for paths in (1, 2, 10):
    power = np.full((1, paths), -100.0, dtype=np.float32)
    phase = np.linspace(0, 360, paths, endpoint=False, dtype=np.float32)[None]
    place = np.array([[100.0, 0.0, 1.5]], dtype=np.float32)
    data = Dataset({"power": power, "phase": phase, "rx_pos": place})
    loss = float(data.compute_pathloss(coherent=False)[0])
    powers = 100.0 - 10.0 * np.log10(paths)
    print(f"{paths} paths of -100 dB: loss {loss:.2f} dB, sum of powers {powers:.2f} dB")
    assert abs(loss - (100.0 - 20.0 * np.log10(paths))) < 0.01, loss
PY
"$folder/venv/bin/python" "$folder/sum.py"
