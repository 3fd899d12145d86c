(** * The programs of CheckerStatements.v as OCaml: kernel.ml.

    Trusted beside the kernel: the extraction itself, and that natural numbers are
    OCaml's 63-bit integers, booleans and lists OCaml's own. *)
From Coq Require Extraction ExtrOcamlBasic ExtrOcamlNatInt.
From DeadEnds Require CheckerStatements.

Extraction Language OCaml.
Extraction "kernel.ml" CheckerStatements.survival_times CheckerStatements.check_certificate.
