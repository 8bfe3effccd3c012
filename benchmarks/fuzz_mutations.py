"""One input becomes a damaged one: by the bytes, by lines and fields, by JSON nodes, by the entries of a zip."""

import gzip
import io
import json
import zipfile
import zlib
from collections.abc import Iterator

import numpy as np

Files = dict[str, bytes]
EVIL = (
    *("1e308", "-1e308", "1e999", "nan", "-inf", "0", "-0", "-1", "1e-320", "0.5", "2147483648", "9" * 25),
    *("", " ", "x", "0x10", "1_0", "\u0661", '"', "'", "#", "a,b", "\x00", "\x1b[31m"),
    *("../../x", "<script>alert(1)</script>", "$\\frac{", "robot1", "NaN", "null", "true", "1" + "0" * 400, "-5e18"),
)
ENDLESS = ("9" * 5000, "[" * 10_000, "w" * 200_000)
RARE = 0.004  # share of the damage that makes something large, which takes long to write and to read
BOMB = 300_000_000  # bytes that an archive unpacks to
LARGEST = 1 << 22  # letters of a text that was blown up
NODES = (None, True, -1, 0, 1e308, float("nan"), 10**30, "", "x", "../x", [], {}, [[]], {"a": 1}, [1, "b", None])
SIZES = (0, 1, 0x7F, 0xFF, 0x7FFFFFFF, 0xFFFFFFFF, 0xFFFFFFF0, 0x40000000)


def mutate(files: Files, rng: np.random.Generator) -> Files:
    """`files` with one to three things wrong."""
    out = dict(files)
    for _ in range(int(rng.integers(1, 4))):
        if not out:
            break
        name = str(rng.choice(sorted(out)))
        if rng.random() < 0.03 and len(out) > 1:
            del out[name]
            continue
        out[name] = _changed(name, out[name], rng)
    return out


def _changed(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    ways = [_bytes]
    if name.endswith((".json",)):
        ways = [_bytes, _json, _json, _json]
    elif name.endswith((".npz", ".zip")):
        ways = [_bytes, _zip, _zip, _zip]
    elif name.endswith(".gz"):
        ways = [_bytes, _gzip, _gzip]
    elif not name.endswith((".db3", ".mcap", ".bag", ".png", ".parquet")):
        ways = [_bytes, _text, _text, _text]
    return ways[int(rng.integers(len(ways)))](data, rng)


def _bytes(data: bytes, rng: np.random.Generator) -> bytes:
    n = len(data)
    if n == 0:
        return rng.bytes(int(rng.integers(0, 40)))
    out, at = bytearray(data), int(rng.integers(n))
    size = min(n - at, int(rng.integers(1, 64)))
    how = int(rng.integers(8))
    if how == 0:
        return data[:at]
    if how == 1:
        for k in rng.integers(n, size=int(rng.integers(1, 8))).tolist():
            out[k] ^= 1 << int(rng.integers(8))
    elif how == 2:
        del out[at : at + size]
    elif how == 3:
        out[at:at] = out[at : at + size] * int(rng.integers(1, 40))
    elif how == 4:
        out[at : at + size] = rng.bytes(size)
    elif how == 5:
        out[at : at + size] = bytes(size)
    elif how == 6:
        width = int(rng.choice([1, 2, 4, 8]))
        value = int(rng.choice(SIZES)) & ((1 << 8 * width) - 1)
        out[at : at + width] = value.to_bytes(width, "little")
    else:
        other = int(rng.integers(n))
        out[at : at + size] = data[other : other + size]
    return bytes(out)


def _text(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.decode("utf-8", "replace").split("\n")
    k, j = (int(v) for v in rng.integers(len(lines), size=2))
    how = int(rng.integers(10))
    if how == 0:
        lines[k], lines[j] = lines[j], lines[k]
    elif how == 1:
        lines.insert(k, lines[j])
    elif how == 2:
        del lines[k]
    elif how in (3, 4, 5, 6, 7):
        for _ in range(int(rng.integers(1, 4))):
            k = int(rng.integers(len(lines)))
            lines[k] = _fields(lines[k], rng)
    elif how == 8:
        lines[k] = (lines[k] * int(rng.integers(2, 3000 if rng.random() < RARE * 10 else 40)))[:LARGEST]
    else:
        lines = [_evil(rng) if rng.random() < 0.1 else line for line in lines]
    text = ("\r\n" if rng.random() < 0.1 else "\n").join(lines)
    text = text[:LARGEST]
    return (b"\xef\xbb\xbf" if rng.random() < 0.05 else b"") + text.encode("utf-8", "replace")


def _fields(line: str, rng: np.random.Generator) -> str:
    mark = "," if "," in line else "\t" if "\t" in line else " "
    words = line.split(mark)
    k = int(rng.integers(len(words)))
    evil = _evil(rng)
    how = int(rng.integers(5))
    if how == 0:
        del words[k]
    elif how == 1:
        words.insert(k, evil)
    else:
        words[k] = evil
    return mark.join(words)


def _evil(rng: np.random.Generator) -> str:
    words = ENDLESS if rng.random() < 2 * RARE else EVIL
    return words[int(rng.integers(len(words)))]


def _json(data: bytes, rng: np.random.Generator) -> bytes:
    try:
        whole = json.loads(data)
    except (ValueError, RecursionError):
        return _bytes(data, rng)
    if rng.random() < 0.02:
        return b"[" * 10_000
    places = list(_places(whole))
    if not places:
        return json.dumps(NODES[int(rng.integers(len(NODES)))]).encode()
    for _ in range(int(rng.integers(1, 4))):
        holder, key = places[int(rng.integers(len(places)))]
        if rng.random() < 0.2 and isinstance(holder, dict):
            holder.pop(key, None)
        elif isinstance(holder, dict) or key < len(holder):
            holder[key] = NODES[int(rng.integers(len(NODES)))]
    return json.dumps(whole).encode()


def _places(node: object) -> Iterator[tuple[dict | list, str | int]]:
    keys = node.keys() if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for key in list(keys):
        yield node, key
        yield from _places(node[key])


def _gzip(data: bytes, rng: np.random.Generator) -> bytes:
    try:
        text = gzip.decompress(data)
    except (OSError, EOFError, ValueError, zlib.error):
        return _bytes(data, rng)
    if rng.random() < RARE / 4:
        return gzip.compress(text + bytes(b"0 " * (BOMB // 2)), 1)
    return gzip.compress(_text(text, rng), 1)


def _zip(data: bytes, rng: np.random.Generator) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # noqa: BLE001  (an archive damaged before)
        return _bytes(data, rng)
    names = sorted(entries)
    if not names:
        return _bytes(data, rng)
    name = names[int(rng.integers(len(names)))]
    how = int(rng.integers(6))
    if how == 0:
        del entries[name]
    elif how == 1:
        entries[name] = entries[names[int(rng.integers(len(names)))]]
    elif name.endswith(".npy"):
        entries[name] = _array(entries[name], rng)
    elif how == 2:
        entries[name] = _bytes(entries[name], rng)
    else:
        entries[name] = _text(entries[name], rng)
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for each, content in entries.items():
            archive.writestr(each, content)
    return held.getvalue()


def _array(data: bytes, rng: np.random.Generator) -> bytes:
    """Another shape, type or values; or a header that promises more than there is; or a bomb."""
    try:
        values = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # noqa: BLE001  (an entry damaged before)
        return _bytes(data, rng)
    how = int(rng.integers(9))
    out = io.BytesIO()
    if how == 0:
        shape = (int(rng.choice([10**9, 2**40, 2**62, -1])), *values.shape[1:])
        fields = {"descr": np.lib.format.dtype_to_descr(values.dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(out, fields)
        return out.getvalue() + data[128:]
    if how == 1 and rng.random() < RARE / 2:
        fields = {"descr": "<f8", "fortran_order": False, "shape": (BOMB,)}
        np.lib.format.write_array_header_1_0(out, fields)
        return out.getvalue() + bytes(BOMB)
    if how == 2:
        values = values.ravel()[: int(rng.integers(values.size + 1))]
    elif how == 3:
        values = np.repeat(values[None], 2, axis=0)
    elif how == 4:
        kind = rng.choice(["U5", "c16", "?", "i1", "S3", "M8[s]", "f2", "u8"])
        values = _cast(values, kind) if values.dtype.kind in "fiub" else np.zeros(values.shape, kind)
    elif how == 5:
        return _bytes(data, rng)
    elif values.size and values.dtype.kind in "fiu":
        values = values.copy()
        at = np.unravel_index(int(rng.integers(values.size)), values.shape)
        whole = values.dtype.kind != "f"
        kinds = [0, 1, np.iinfo(values.dtype).max] if whole else [1e308, -1e308, np.nan, np.inf, 0.0, -1.0]
        with np.errstate(all="ignore"):
            values[at] = kinds[int(rng.integers(len(kinds)))]
    else:
        values = values.T
    np.lib.format.write_array(out, np.asarray(values), allow_pickle=False)
    return out.getvalue()


@np.errstate(all="ignore")
def _cast(values: np.ndarray, kind: str) -> np.ndarray:
    return np.asarray(values.astype(kind, casting="unsafe"))


def smaller(files: Files) -> Iterator[Files]:
    """Inputs with a part of `files` left out, the largest parts first."""
    for name, data in files.items():
        if len(files) > 1:
            yield {other: held for other, held in files.items() if other != name}
        for parts in (2, 4, 8, 16):
            lines = data.split(b"\n")
            size = -(-len(lines) // parts)
            if len(lines) >= parts:
                for at in range(0, len(lines), size):
                    yield files | {name: b"\n".join(lines[:at] + lines[at + size :])}
