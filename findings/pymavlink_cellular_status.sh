#!/usr/bin/env bash
# pymavlink 2.4.50: no dialect knows CELLULAR_STATUS (message 334), not even "common" and "all".
#
# Guess: MAVLink has CELLULAR_STATUS in its common.xml since 2020, every autopilot with a modem may
# send it, so mavutil reads it out of a telemetry log with dialect="common", and surely with "all".
#
# Seen: 334 is in none of the shipped dialects. The log is read without a word of warning, the valid
# message becomes UNKNOWN_334 with its bytes in `data`, and recv_match(type="CELLULAR_STATUS") finds
# nothing. GLOBAL_POSITION_INT out of the same log is read as ever.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" --disable-pip-version-check install --quiet "pymavlink==2.4.50" "lxml"
cat > "$folder/read.py" <<'PY'
import os
import pkgutil
import struct
import sys

os.environ["MAVLINK20"] = "1"
from importlib import import_module

import pymavlink
from pymavlink import mavutil
from pymavlink.dialects import v20
from pymavlink.dialects.v20 import common
from pymavlink.generator.mavcrc import x25crc

print("pymavlink", pymavlink.__version__)
known = [
    name for _, name, _ in pkgutil.iter_modules(v20.__path__)
    if 334 in getattr(import_module(f"pymavlink.dialects.v20.{name}"), "mavlink_map", {})
]
print("dialects that know message 334:", known or "none")

# One valid frame of MAVLink 2: mcc, mnc, lac, status (registered), reason, type (LTE), quality.
payload = struct.pack("<HHHBBBB", 232, 1, 11, 9, 0, 4, 70)
head = bytes([len(payload), 0, 0, 0, 1, 1]) + (334).to_bytes(3, "little")
crc = x25crc(head + payload)
crc.accumulate(bytes([72]))  # CRC_EXTRA of CELLULAR_STATUS in common.xml
cellular = b"\xfd" + head + payload + struct.pack("<H", crc.crc)
sender = common.MAVLink(None, srcSystem=1)
place = sender.global_position_int_encode(0, 482000000, 163700000, 300000, 30000, 0, 0, 0, 0)
stamp = struct.pack(">Q", 1_700_000_000_000_000)
with open(sys.argv[1], "wb") as log:
    log.write((stamp + bytes(place.pack(sender)) + stamp + cellular) * 3)

for dialect in ("common", "all"):
    log = mavutil.mavlink_connection(sys.argv[1], dialect=dialect)
    kinds = []
    while (message := log.recv_match()) is not None:
        kinds.append(message.get_type())
    again = mavutil.mavlink_connection(sys.argv[1], dialect=dialect)
    found = again.recv_match(type="CELLULAR_STATUS")
    print(f"{dialect}: {kinds[:2]}, recv_match(type='CELLULAR_STATUS') gives {found}")
    assert kinds == ["GLOBAL_POSITION_INT", "UNKNOWN_334"] * 3, kinds
    assert found is None
assert not known
PY
"$folder/venv/bin/python" "$folder/read.py" "$folder/flight.tlog"
