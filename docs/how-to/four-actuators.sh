#!/bin/sh
# Characterises four emulated actuators in three conditions, with nobody there: torque constant and friction of each.
# Everything lies in ./four-actuators: the benches, the campaign, its runs with their index, and report.html.
# After whatever ended it, the same command goes on, with the run that was cut off.
set -eu
mkdir -p four-actuators
cd four-actuators

# A bench for each actuator. Its torque constant, in N*m/A, is what the campaign has to find out.
leactl bench show emulated > emulated.yaml
bench() {
    sed -e "s/^name: emulated$/name: bench-of-lea-$1/" \
        -e "s/^  seed: 1$/  test: {torque_constant: $2}/" emulated.yaml > "lea-$1.yaml"
}
bench 1 0.490
bench 2 0.481
bench 3 0.502
bench 4 0.495

# Two experiments for each actuator. They are short: without `set` every run is as long as its protocol has it.
{
    echo "name: four-actuators"
    echo "bench: lea-1.yaml" # required; every step names its own
    echo "conditions: [unloaded, design, loaded]"
    echo "steps:"
    for n in 1 2 3 4; do
        echo "  - name: torque-constant-$n"
        echo "    protocol: torque-constant"
        echo "    bench: lea-$n.yaml"
        echo "    actuators: [LEA-$n]"
        echo "    set: {trials: 1, levels_A: [4.9, 9.8, 14.7], rest_s: 5}"
        echo "  - name: friction-$n"
        echo "    protocol: friction"
        echo "    bench: lea-$n.yaml"
        echo "    actuators: [LEA-$n]"
        echo "    set: {trials: 1, hold_s: 2, settle_s: 1}"
    done
} > campaign.yaml

leactl campaign campaign.yaml --out runs --yes
leactl runs index runs
leactl report runs --html report.html
