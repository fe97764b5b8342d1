"""Prior of a drive's remaining time: seconds a frame of each stage, by the drives of a service.

    wayloom demo --port 8088          # leaves the service running
    python benchmarks/eta_prior.py --to http://127.0.0.1:8088

The table goes to `wayloom.store.etas.intervals.SECONDS_A_FRAME`.
"""

import argparse
import statistics

import httpx2


def main() -> None:
    """Print stage and median seconds a frame."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--to", default="http://127.0.0.1:8088")
    url = parser.parse_args().to
    found: dict[str, list[float]] = {}
    for drive in httpx2.get(f"{url}/v1/drives?limit=500&state=done", trust_env=False).json()["drives"]:
        frames = drive["facts"]["log"]["frames"]["count"]
        for stage in drive["stages"]:
            if stage["state"] == "done" and stage["seconds"] is not None:
                found.setdefault(stage["stage"], []).append(stage["seconds"] / frames)
    for stage, values in found.items():
        print(f"{stage:14} {statistics.median(values):8.4f} s a frame, {len(values)} drives")


if __name__ == "__main__":
    main()
