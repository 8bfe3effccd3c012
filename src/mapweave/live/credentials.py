"""A small authority for a team: a certificate for each process, and who may say what.

A folder a process: `authority.pem`, `certificate.pem`, `key.pem` and `access.json`. The certificate's common name is
the process's name; Zenoh checks it on every link, both ways, and the access list says under which keys it may speak.
"""

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ..core.errors import DataError, ReaderError, UsageError
from ..io.directory import read_json, write_json
from .messages import Topics, check_name

AUTHORITY, CERTIFICATE, KEY, ACCESS = "authority.pem", "certificate.pem", "key.pem", "access.json"
SECRET = "authority-key.pem"  # noqa: S105  (the name of a file)
SPEAKING = ["put", "delete", "declare_queryable", "reply", "liveliness_token"]
HEARING = ["declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber"]
ALL = [*SPEAKING, *HEARING]


@dataclass(frozen=True, slots=True)
class Authority:
    """Who signs a team's certificates."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def make_team(
    folder: Path, team: str, robots: Sequence[str], maps: Sequence[str], days: float, now: dt.datetime
) -> list[Path]:
    """The folder of each process, made anew for those that have none, under one authority that is made once.

    Added robots are put on the access list of everybody: all `access.json` are written again.
    """
    for name in (*robots, *maps):
        check_name(name, "--robots" if name in robots else "--maps")
    twice = [name for name in {*robots, *maps} if [*robots, *maps].count(name) > 1]
    if twice:
        raise UsageError(f"--robots, --maps: {min(twice)} comes twice")
    folder.mkdir(parents=True, exist_ok=True)
    authority = _authority(folder, team, now)
    known = _known(folder)
    for name in (*robots, *maps):
        role = "robot" if name in robots else "map"
        if known.get(name, role) != role:
            raise UsageError(f"{folder}: {name} is a {known[name]} already")
        known[name] = role
    homes = []
    for name in known:
        home = folder / name
        home.mkdir(exist_ok=True)
        if not (home / CERTIFICATE).exists():
            issue(authority, home, name, now, now + dt.timedelta(days=days))
        write_json(home / ACCESS, {"team": team, "names": known})
        homes.append(home)
    return homes


def issue(authority: Authority, home: Path, name: str, begin: dt.datetime, end: dt.datetime) -> None:
    """Key and certificate of `name` in `home`, valid from `begin` to `end`."""
    key = ec.generate_private_key(ec.SECP256R1())
    usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    certificate = (
        _builder(name, authority.certificate.subject, begin, end)
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        .sign(authority.key, hashes.SHA256())
    )
    _write_secret(home / KEY, key)
    (home / CERTIFICATE).write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    (home / AUTHORITY).write_bytes(authority.certificate.public_bytes(serialization.Encoding.PEM))


def tls_settings(home: Path, now: dt.datetime | None = None) -> dict[str, object]:
    """Zenoh's settings for the process whose certificate is in `home`; raises UsageError when it does not serve."""
    _check_pair(home, now or dt.datetime.now(dt.UTC))
    team, known = _access(home / ACCESS)
    where = {name: str((home / name).absolute()) for name in (AUTHORITY, CERTIFICATE, KEY)}
    return {
        "transport/link/tls": {
            "root_ca_certificate": where[AUTHORITY],
            "enable_mtls": True,
            "verify_name_on_connect": False,  # robots change their addresses; the access list goes by their names
            "close_link_on_expiration": True,
            "listen_certificate": where[CERTIFICATE],
            "listen_private_key": where[KEY],
            "connect_certificate": where[CERTIFICATE],
            "connect_private_key": where[KEY],
        },
        "transport/link/protocols": ["tls"],
        "scouting/multicast/enabled": False,
        "access_control": access_control(team, known),
    }


def expect_heard(home: Path, name: str, team: str, role: str) -> None:
    """Raises UsageError where the others would refuse all that this process says: it shows the certificate in `home`.

    role: robot or map, as on the access list.
    """
    certificate = _check_pair(home, dt.datetime.now(dt.UTC))
    its_team, names = _access(home / ACCESS)
    holder = str(certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)
    if its_team != team:
        raise UsageError(f"--tls {home}: of team {its_team}, and this is team {team}")
    if holder not in names:
        raise UsageError(f"--tls {home}: {holder} is not on the list of who may speak, {ACCESS}")
    if names[holder] != "map" and (role == "map" or holder != name):
        told = "a map process" if role == "map" else name
        raise UsageError(f"--tls {home}: the certificate is robot {holder}'s: {told} would not be heard with it")


def access_control(team: str, names: dict[str, str]) -> dict[str, object]:
    """Who may say what, in Zenoh's terms: a robot under its own name, a map process anything, nobody else anything."""
    t = Topics(team)
    everywhere = [f"mapweave/{team}/**", f"mapweave/{team}/@map/**"]
    rules: list[dict[str, object]] = [
        _rule("everything", everywhere, ALL, ["ingress", "egress"]),
        _rule("hear", everywhere, [*HEARING], ["ingress", "egress"]),
        # what leaves for a robot: all that it may hear
        _rule("told", everywhere, SPEAKING, ["egress"]),
    ]
    policies: list[dict[str, object]] = []
    subjects: list[dict[str, object]] = []
    for name, role in names.items():
        subjects.append({"id": name, "cert_common_names": [name]})
        if role == "map":
            policies.append({"rules": ["everything"], "subjects": [name]})
            continue
        own = [t.log(name).rsplit("/", 1)[0] + "/**"]
        rules.append(_rule(f"speak as {name}", own, SPEAKING, ["ingress"]))
        policies.append({"rules": ["hear", "told", f"speak as {name}"], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, keys: list[str], messages: Sequence[str], flows: list[str]) -> dict[str, object]:
    return {"id": name, "permission": "allow", "messages": list(messages), "flows": flows, "key_exprs": keys}


def _authority(folder: Path, team: str, now: dt.datetime) -> Authority:
    certificate, secret = folder / AUTHORITY, folder / SECRET
    if certificate.exists() and secret.exists():
        key = serialization.load_pem_private_key(secret.read_bytes(), None)
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise ReaderError(secret, "expected an elliptic curve key")
        return Authority(x509.load_pem_x509_certificate(certificate.read_bytes()), key)
    if certificate.exists() or secret.exists():
        raise UsageError(f"{folder}: holds one of {AUTHORITY} and {SECRET} without the other")
    key = ec.generate_private_key(ec.SECP256R1())
    name = f"mapweave authority of {team}"
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    root = (
        _builder(name, subject, now, now + dt.timedelta(days=3650))
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    _write_secret(secret, key)
    certificate.write_bytes(root.public_bytes(serialization.Encoding.PEM))
    return Authority(root, key)


def _builder(name: str, issuer: x509.Name, begin: dt.datetime, end: dt.datetime) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]))
        .issuer_name(issuer)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin - dt.timedelta(hours=1))  # clocks of robots differ
        .not_valid_after(end)
    )


def _write_secret(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
    """The key, readable by its owner alone."""
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    path.touch(mode=0o600)
    path.write_bytes(pem)


def _known(folder: Path) -> dict[str, str]:
    """Names and roles on the access list of a team's folder."""
    for path in sorted(folder.glob(f"*/{ACCESS}")):
        return _access(path)[1]
    return {}


def _access(path: Path) -> tuple[str, dict[str, str]]:
    access = read_json(path)
    team, names = access.get("team"), access.get("names")
    if not isinstance(team, str) or not isinstance(names, dict) or not set(names.values()) <= {"robot", "map"}:
        raise ReaderError(path, "expected a team and names with their roles, robot or map")
    there = str(path)
    return check_name(team, there, DataError), {check_name(str(n), there, DataError): str(r) for n, r in names.items()}


def _check_pair(home: Path, now: dt.datetime) -> x509.Certificate:
    """The certificate; UsageError unless it is valid now, of the authority beside it, and the key belongs to it."""
    for name in (AUTHORITY, CERTIFICATE, KEY, ACCESS):
        if not (home / name).is_file():
            raise UsageError(f"--tls {home}: expected {name} there, found none")
    try:
        authority = x509.load_pem_x509_certificate((home / AUTHORITY).read_bytes())
        certificate = x509.load_pem_x509_certificate((home / CERTIFICATE).read_bytes())
        key = serialization.load_pem_private_key((home / KEY).read_bytes(), None)
    except (ValueError, TypeError) as error:
        raise UsageError(f"--tls {home}: {CERTIFICATE} or {KEY} cannot be read: {error}") from None
    form = (serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
    if certificate.public_key().public_bytes(*form) != key.public_key().public_bytes(*form):
        raise UsageError(f"--tls {home}: {KEY} does not belong to {CERTIFICATE}")
    if now > certificate.not_valid_after_utc:
        raise UsageError(f"--tls {home}: the certificate expired on {certificate.not_valid_after_utc:%Y-%m-%d}")
    if now < certificate.not_valid_before_utc:
        raise UsageError(f"--tls {home}: the certificate begins on {certificate.not_valid_before_utc:%Y-%m-%d}")
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        raise UsageError(f"--tls {home}: {AUTHORITY} did not sign {CERTIFICATE}: they are of two teams") from None
    return certificate
