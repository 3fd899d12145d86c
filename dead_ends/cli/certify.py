"""``certify FILE --out CERTIFICATE``: labels with witnesses that ``check`` verifies."""

from __future__ import annotations

import argparse

from dead_ends.cli.source import add_source_arguments, print_rows, read_source

SUMMARY = "write labels with a certificate that proves them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    parser.add_argument(
        "--out", metavar="CERTIFICATE", required=True, help="the certificate (.npz or .json)"
    )


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.certificate import certify, save_certificate

    certificate = certify(read_source(arguments))
    save_certificate(arguments.out, certificate)
    print(f"wrote {arguments.out}")
    print_rows([("model", f"sha256 {certificate.digest}")])
    return 0
