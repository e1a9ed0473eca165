"""Attacks on bus and orders from another process in a network namespace that has only a loopback interface.

    ./headland benchmark bus_attacks [--trials 1000] [--only spoof] [--out FOLDER]

Gateway, order gate, simulated tractor and the sockets are the real ones. The clock is simulated (20 ms per step, the
attacker sends within the step), so that a busy computer changes no result. The supervisor is replaced by one that
demands a fault stop 100 ms after the first fault, later than the real one. Rows are kept in rows.jsonl; the same
command continues. A trial passes if the attack is named within 200 ms and the machine stops within its stopping
distance S; an order must be refused and named within 200 ms.
"""

import argparse
import base64
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from benchmarks.bus_rig import MS, BusRig, OrderRig
from simulation.operator import public_bytes

BUS_ATTACKS = {
    "spoof": {"gateway.foreign_source", "gateway.foreign_command", "gateway.second_tractor", "gateway.tractor_silent"},
    "replay": {"gateway.foreign_source", "gateway.second_tractor", "gateway.tractor_silent"},
    "flood": {"gateway.flood"},
    "bus_off": {"gateway.bus"},
}
ORDER_ATTACKS = ("forged_order", "replayed_order")
LIMIT_MS = 200
ATTACK_S = 6.0
INSIDE = "HEADLAND_IN_NAMESPACE"


class Attacker:
    """The attacking process; each line is answered when it has sent everything."""

    def __init__(self, bus: str, order_port: int) -> None:
        words = [sys.executable, "-m", "benchmarks.bus_attacker", *bus.split(":")[1:], str(order_port)]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __call__(self, **line: Any) -> None:
        """Sends a line and waits for the answer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(line) + "\n")
        self._process.stdin.flush()
        if self._process.stdout.readline() != ".\n":
            raise SystemExit("the attacking process has ended")

    def close(self) -> None:
        """Ends the process."""
        self._process.terminate()
        self._process.wait()


def bus_trial(rig: BusRig, attacker: Attacker, name: str, seed: int) -> dict[str, Any]:
    """One attack while driving."""
    random = np.random.default_rng([seed, *name.encode()])
    speed_mps = float(random.uniform(0.5, 3.5))
    rig.drive(speed_mps)
    attacker(listen=1)
    for _ in range(int(random.integers(10, 20))):
        rig.step()
        attacker(listen=1)
    false_alarms = sorted(rig.faults)
    s_m, start_ns, at_m = rig.stopping_distance_m(), rig.now_ns, rig.travelled_m
    attacker(attack=name, seed=seed)
    fastest_mps, tick = 0.0, 0
    while rig.now_ns - start_ns < ATTACK_S * 1e9 and not (tick > 5 and rig.is_standing):
        attacker(tick=tick)
        rig.step()
        fastest_mps, tick = max(fastest_mps, rig.speed_mps), tick + 1
    attacker(up=1)
    seen = {code: ns for code, ns in rig.first_ns.items() if ns >= start_ns}
    named = [ns for code, ns in seen.items() if code in BUS_ATTACKS[name]]
    detected_ms = (min(named) - start_ns) / MS if named else None
    travel_m = rig.travelled_m - at_m
    return {
        "speed_mps": round(speed_mps, 3), "fastest_mps": round(fastest_mps, 3), "detected_ms": detected_ms,
        "codes": sorted(seen), "false_alarms": false_alarms, "travel_m": round(travel_m, 3), "s_m": round(s_m, 3),
        "passed": detected_ms is not None and detected_ms <= LIMIT_MS and rig.is_standing and travel_m <= s_m
        and not false_alarms,
    }  # fmt: skip


def order_trial(rig: OrderRig, attacker: Attacker, name: str, seed: int) -> dict[str, Any]:
    """One order that must be refused, after one that is accepted."""
    random = np.random.default_rng([seed, *name.encode()])
    rig.step(seconds=0.3)
    good = rig.signed()
    attacker(datagrams=[base64.b64encode(good).decode()])
    accepted_before = rig.accepted
    rig.step()
    is_usable = rig.accepted == accepted_before + 1
    rig.step(seconds=float(random.uniform(0.0, 2.0)))
    bad = forged(rig, good, random) if name == "forged_order" else replayed(rig, good, random)
    accepted, refused, start_ns = rig.accepted, rig.refused, rig.now_ns
    attacker(datagrams=[base64.b64encode(bad).decode()])
    rig.step()
    detected_ms = (rig.now_ns - start_ns) / MS if rig.refused == refused + 1 else None
    return {
        "detected_ms": detected_ms, "codes": sorted(rig.faults), "accepted": rig.accepted - accepted,
        "passed": is_usable and rig.accepted == accepted and detected_ms is not None and detected_ms <= LIMIT_MS,
    }  # fmt: skip


def forged(rig: OrderRig, good: bytes, random: np.random.Generator) -> bytes:
    """An order that the key's owner did not sign as it is."""
    stranger = Ed25519PrivateKey.from_private_bytes(random.bytes(32))
    content = rig.content()
    payload = json.dumps(content).encode()
    flipped = bytearray(good)
    flipped[int(random.integers(len(good)))] ^= 1 << int(random.integers(8))
    return [
        bytes(flipped),
        stranger.sign(payload) + public_bytes(stranger) + payload,
        stranger.sign(payload) + good[64:96] + payload,
        good[:96] + payload,
        random.bytes(64) + good[64:96] + payload,
        rig.signed(machine="other-1"),
        rig.signed(session="00" * 16),
        rig.signed(authority="operator"),
    ][int(random.integers(8))]


def replayed(rig: OrderRig, good: bytes, random: np.random.Generator) -> bytes:
    """An order that was accepted once, an older one, one that has expired, or one that was held back."""
    late = rig.signed(signed_ns=rig.now_ns - 4 * 10**9)
    return [good, rig.earlier(random), rig.signed(expires_ns=rig.now_ns - 1), late][int(random.integers(4))]


def rows_of(path: Path) -> list[dict[str, Any]]:
    """Complete rows of an earlier run."""
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.is_file() else []
    whole = [line for line in lines if line.endswith("\n")]
    if len(whole) < len(lines):
        path.write_text("".join(whole), encoding="utf-8")
    return [json.loads(line) for line in whole]


def table(rows: list[dict[str, Any]]) -> str:
    """One line per attack."""
    lines = []
    for name in dict.fromkeys(row["attack"] for row in rows):
        own = [row for row in rows if row["attack"] == name]
        times = [row["detected_ms"] for row in own if row["detected_ms"] is not None]
        shares = [row["travel_m"] / row["s_m"] for row in own if "s_m" in row]
        text = f"{name}: {sum(row['passed'] for row in own)} of {len(own)} passed; named in "
        text += f"{np.median(times):.0f} ms (worst {max(times):.0f} ms)" if times else "no trial"
        lines.append(text + (f"; travel at most {max(shares):.0%} of S" if shares else "; none accepted"
                             if not any(row.get("accepted") for row in own) else "; ACCEPTED"))  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Prints one line per attack; exit code 1 if a trial did not pass."""
    parser = argparse.ArgumentParser(description="attacks on the bus and on orders from another process")
    parser.add_argument("--trials", type=int, default=1000, help="trials per attack")
    parser.add_argument("--only", choices=[*BUS_ATTACKS, *ORDER_ATTACKS], help="this attack only")
    parser.add_argument("--out", type=Path, help="folder of rows.jsonl (default: a new one)")
    arguments = parser.parse_args()
    if INSIDE not in os.environ:
        command = ["unshare", "-rn", "sh", "-c", 'ip link set lo up && exec "$@"', "sh", sys.executable, "-m",
                   "benchmarks.bus_attacks", *sys.argv[1:]]  # fmt: skip
        os.execvpe("unshare", command, {**os.environ, INSIDE: "1"})
    top = (arguments.out or Path(tempfile.mkdtemp(prefix="bus-attacks-"))).absolute()
    top.mkdir(parents=True, exist_ok=True)
    rows = rows_of(top / "rows.jsonl")
    done = {(row["attack"], row["seed"]) for row in rows}
    names = [arguments.only] if arguments.only else [*BUS_ATTACKS, *ORDER_ATTACKS]
    orders = OrderRig(top / "state")
    rig = BusRig()
    attacker = Attacker(rig.bus_name, orders.port)
    try:
        for name, seed in [(name, k) for k in range(arguments.trials) for name in names if (name, k) not in done]:
            result = (
                bus_trial(rig, attacker, name, seed)
                if name in BUS_ATTACKS
                else order_trial(orders, attacker, name, seed)
            )
            rows.append({"attack": name, "seed": seed} | result)
            with (top / "rows.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            if not result["passed"]:
                print(f"FAILED {rows[-1]}", flush=True)
    finally:
        attacker.close()
        orders.close()
        rig.close()
    print(f"{table(rows)}\n{top}")
    sys.exit(0 if all(row["passed"] for row in rows) else 1)


if __name__ == "__main__":
    main()
