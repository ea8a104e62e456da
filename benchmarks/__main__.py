"""``python -m benchmarks NAME [DATA] [--option value]``"""

import sys

from benchmarks import (  # noqa: F401 - each registers its studies
    calibration,
    cities,
    combined,
    evaluations,
    first_minutes,
    foreign,
    kriging,
    learning,
    measured,
    memory,
    mission_live,
    missions,
    networks,
    planning,
    predictors,
    rays,
    speed,
    throughput,
    unseen,
)
from benchmarks.study import main

if __name__ == "__main__":
    main(sys.argv[1:])
