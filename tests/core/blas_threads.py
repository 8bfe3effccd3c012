"""How many threads BLAS uses here and there; run as a program it prints what `worker_pool` makes of it."""

import sys
from concurrent.futures import ThreadPoolExecutor

import scipy.linalg  # noqa: F401  (its BLAS is one of those looked at)
from threadpoolctl import threadpool_info

from mapweave.core.workers import worker_pool


def threads(_=None):
    """The thread counts of all BLAS libraries of this process."""
    return {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}


def main():
    lines = []
    say = lines.append
    say(f"before {threads()}")
    with ThreadPoolExecutor(1) as mine:
        with worker_pool(1, 1, mine) as pool:
            say(f"theirs {list(pool.map(threads, range(2)))}")
            say(f"submitted {pool.submit(divmod, 7, 2).result()}")
        say(f"after {mine.submit(threads).result()}")  # the caller's executor is still open, and its own again
    with worker_pool(2, 2) as pool:
        say(f"ours {list(pool.map(threads, range(2)))}")
    with worker_pool(1, 9) as pool:
        say(f"here {pool}")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
