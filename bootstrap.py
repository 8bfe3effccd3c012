"""Sets everything up in `.venv` and runs one job: `python3 bootstrap.py demo` or `python3 bootstrap.py test`.

Needs Python >= 3.11 and nothing else. Words after the job go to it: `python3 bootstrap.py test -k se2`;
`python3 bootstrap.py test --all` runs the slow tests too.
"""

import os
import subprocess
import sys
import venv
from pathlib import Path

HERE = Path(__file__).resolve().parent


def main() -> int:
    if len(sys.argv) < 2 or sys.argv[1] not in ("demo", "test"):
        print(__doc__)
        return 2
    job, more = sys.argv[1], sys.argv[2:]
    home = Path(os.environ.get("MAPWEAVE_VENV", HERE / ".venv"))
    binaries = home / ("Scripts" if os.name == "nt" else "bin")
    python = binaries / ("python.exe" if os.name == "nt" else "python")
    if not python.exists():
        print(f"making {home}", flush=True)
        venv.create(home, with_pip=True)
    extra = "[test]" if job == "test" else ""
    print(f"installing into {home}: about 500 MB, half a minute where the packages are near", flush=True)
    # a third of what is installed is imported: that alone becomes byte code
    install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
    done = subprocess.run([*install, "-c", str(HERE / "constraints.txt"), "-e", f"{HERE}{extra}"], check=False)
    if done.returncode:
        return done.returncode
    if job == "demo":
        return subprocess.run([str(python), "-m", "mapweave", "demo", *more], check=False).returncode
    usual = {"-n": "-nauto", "--dist": "--dist=worksteal", "--durations": "--durations=15"}
    words = [word for name, word in usual.items() if not any(given.startswith(name) for given in more)]
    # one thread a process: the workers share the cores; shapes are checked at run time where everything is
    environ = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    environ["MAPWEAVE_TYPECHECK"] = "1" if "--all" in more else "0"
    environ["PYTHONPYCACHEPREFIX"] = str(home / "byte-code")  # made once for all processes, and beside no source
    environ |= {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return subprocess.run([str(python), "-m", "pytest", *words, *more], cwd=HERE, env=environ, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
