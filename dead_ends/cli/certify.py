"""``certify FILE --out CERTIFICATE``: labels with witnesses that ``check`` checks."""

from __future__ import annotations

import argparse

from dead_ends.cli.output import add_output_argument, check_output
from dead_ends.cli.source import add_source_arguments, print_rows, read_source

SUMMARY = "write labels with a certificate that proves them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    add_output_argument(parser, "the certificate (.npz or .json)", metavar="CERTIFICATE")


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.certificates.certificate import certify, save_certificate

    check_output(arguments.out, arguments.file)
    certificate = certify(read_source(arguments))
    save_certificate(certificate, arguments.out)
    print(f"wrote {arguments.out}")
    print_rows([("model", f"sha256 {certificate.digest}")])
    return 0
