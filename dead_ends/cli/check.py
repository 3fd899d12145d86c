"""``check CERTIFICATE FILE``: do the witnesses prove the labels of this model?

The verdict is that of :mod:`dead_ends.certificates.checker`, which shares no code with the
solver. Exit status 1 if the certificate is refused.
"""

from __future__ import annotations

import argparse
import sys

from dead_ends.cli.source import add_source_arguments, print_rows, read_source

SUMMARY = "check a certificate, independently of the solver"
REFUSED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("certificate", metavar="CERTIFICATE", help="a file written by certify")
    add_source_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.certificates.certificate import load_certificate
    from dead_ends.certificates.checker import CertificateError, check_certificate
    from dead_ends.labels.labelling import Label

    certificate = load_certificate(arguments.certificate)
    model = read_source(arguments)
    try:
        check_certificate(model, certificate)
    except CertificateError as error:
        print(f"refused: {error}", file=sys.stderr)
        return REFUSED
    print("accepted: every label is proved")
    print_rows(
        [
            (label.name.lower().replace("_", " "), int((certificate.labels == label).sum()))
            for label in sorted(Label)
        ]
    )
    return 0
