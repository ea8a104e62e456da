#!/bin/sh
# The test cities, T4, with everything that was chosen on T2 and T3:  sh benchmarks/test_cities.sh DATA.zarr.zip [OUT]
# Each comparison can be killed and goes on; tables and numbers are copied to benchmarks/results/test_cities_*, from where
# benchmarks/document_tables.py takes those of README.md and docs/. ONLY="planners spread" runs some of them.
set -eu
data=$1 out=${2:-surveys/test-cities}
here=$(dirname "$0")
skygain=${SKYGAIN:-skygain}

compare() {
    name=$1
    shift
    case " ${ONLY:-$name} " in *" $name "*) ;; *) return 0 ;; esac
    "$skygain" evaluate --data "$data" --split T4 --out "$out/$name" "$@"
    cp "$out/$name/table.md" "$here/results/test_cities_$name.md"
    cp "$out/$name/results.json" "$here/results/test_cities_$name.json"
    cp "$out/$name/rmse_vs_steps.png" "$here/../docs/images/test_cities_$name.png"
}

# Predictors, random waypoints, three UAVs from a cluster.
compare predictors --max-surveys 60 --planners random-waypoint \
    --predictors kriging,paper-unet,paper-unet-mapblind,unet,operator

# The paper's U-Nets trained for 81,600 samples more than those that ship (a run called paper-unet-longer, begun from paper-unet).
compare longer --max-surveys 60 --planners random-waypoint --predictors operator,paper-unet,paper-unet:weights=paper-unet-longer

# Planners, three UAVs from a cluster: the paper's predictor, ours, and Kriging.
both="paper-unet / random-waypoint,paper-unet / greedy-variance,paper-unet / lawnmower,paper-unet / sequential-greedy"
both="$both,paper-unet / imitation,paper-unet / dqn"
both="$both,operator / random-waypoint,operator / greedy-variance,operator / lawnmower,operator / sequential-greedy,operator / lookahead"
compare planners --max-surveys 30 --methods "$both"

# The same from starts all over the map, and with five UAVs from a cluster.
few="random-waypoint greedy-variance"
spread="" five=""
for planner in $few dqn; do
    spread="$spread,paper-unet / $planner" five="$five,paper-unet:weights=paper-unet-5 / $planner"
done
for planner in $few lookahead; do
    spread="$spread,operator / $planner" five="$five,operator / $planner"
done
compare spread --max-surveys 12 --start spread --methods "${spread#,}"
compare five --max-surveys 12 --uavs 5 --methods "${five#,}"

# Higher up: one survey in each city, random waypoints. The paper has one model per altitude, ours is the same at all of them.
for metres in 10 20 30; do
    unet=paper-unet
    [ "$metres" = 10 ] || unet="paper-unet:weights=paper-unet-${metres}m"
    compare "altitude_$metres" --max-surveys 30 --altitude "$metres" --planners random-waypoint --predictors "kriging,$unet,operator"
done
