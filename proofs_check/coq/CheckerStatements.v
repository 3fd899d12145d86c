(** * The extracted programs, and what is claimed of them.

    A labelling function for deterministic models and a checker of certificates, for
    deterministic and stochastic models, on states 0..n-1.  Each [..._statement] is
    proved, under the same name, in CheckerTheorems.v; Extract.v turns the programs
    into OCaml. *)
From Coq Require Import List Arith Bool Reals.
From DeadEnds Require Import Statements.
Import ListNotations.
Open Scope nat_scope.

(** ** Labelling: rows of successors and the fail mask, to survival times (None: safe). *)
Section Labelling.
Variables (rows : list (list nat)) (bad : list bool).
Definition table_edge i j := In j (nth i rows []).
Definition table_fail i := nth i bad false.
Definition well_formed := length bad = length rows /\
  forall i, i < length rows -> nth i rows [] <> [] /\ forall j, In j (nth i rows []) -> j < length rows.

Definition still_alive (alive : list bool) : list bool :=
  map (fun rb : list nat * bool => negb (snd rb) && existsb (fun j => nth j alive false) (fst rb))
      (combine rows bad).
Definition note k (ta : option nat * bool) : option nat :=
  match fst ta with Some t => Some t | None => if snd ta then None else Some k end.
Fixpoint rounds fuel k alive times : list (option nat) :=
  match fuel with
  | O => times
  | S f => rounds f (S k) (still_alive alive) (map (note k) (combine times alive))
  end.
Definition survival_times : list (option nat) :=
  rounds (S (length rows)) 0 (map negb bad) (map (fun _ => None) rows).
End Labelling.

Definition Labelling_statement : Prop := forall rows bad i, well_formed rows bad -> i < length rows ->
  let edge := table_edge rows in let fail := table_fail bad in
  (Safe edge fail i <-> nth i (survival_times rows bad) None = None) /\
  (fail i = true <-> nth i (survival_times rows bad) None = Some 0) /\
  (Dead edge fail i <-> exists k, nth i (survival_times rows bad) None = Some (S k)) /\
  forall k, SurvivalTime edge fail i k <-> nth i (survival_times rows bad) None = Some k.

(** ** Certificates *)
Inductive Label := FAIL | DEAD | SAFE | AT_RISK.

Section Certificate.
(** The model: [acts i] lists, for each action, the possible successors; [[]]: not available.
    The rows of fail and terminal states are ignored; terminal states (goals) stay. *)
Variables (n : nat) (fail terminal : nat -> bool) (acts : nat -> list (list nat)).
(** The certificate: for each state a label and three witnesses. *)
Variables (label : nat -> Label) (rank escape : nat -> nat) (action : nat -> option nat).

Definition some_of (l : list nat) := match l with [] => false | _ => true end.
Definition choices i := if fail i || terminal i then [[i]] else filter some_of (acts i).
Definition chosen i a :=
  if terminal i then (if a <? length (acts i) then [i] else []) else nth a (acts i) [].
Definition unsafe_label j := match label j with SAFE => false | _ => true end.
Definition doomed_label j := match label j with FAIL | DEAD => true | _ => false end.
Definition safe_label j := match label j with SAFE => true | _ => false end.

(** Every action may come closer to fail without becoming safe. *)
Definition dangerous i :=
  forallb (existsb (fun j => unsafe_label j && (rank j <? rank i))) (choices i).
(** Some action comes closer by exactly one step. *)
Definition tight i := existsb (forallb (fun j => S (rank j) =? rank i)) (choices i).
Definition doomed i := forallb (forallb doomed_label) (choices i).
Definition stays i a := some_of (chosen i a) && forallb safe_label (chosen i a).
Definition nears i a :=
  existsb (fun j => negb (doomed_label j) && (escape j <? escape i)) (chosen i a).

Definition check_witness (det : bool) i :=
  match label i, action i with
  | FAIL, None => fail i && (rank i =? 0) && (escape i =? 0)
  | DEAD, None => negb (fail i) && (0 <? rank i) && (escape i =? 0) && doomed i && dangerous i
                  && (negb det || tight i)
  | SAFE, Some a => negb (fail i) && (rank i =? 0) && (escape i =? 0) && stays i a
  | AT_RISK, Some a => negb det && negb (fail i) && (0 <? rank i) && (0 <? escape i)
                       && dangerous i && nears i a
  | _, _ => false
  end.
Definition at_most_one (l : list nat) := match l with _ :: _ :: _ => false | _ => true end.
Definition check_row (det : bool) i :=
  fail i || terminal i ||
  (existsb some_of (acts i) && forallb (forallb (fun j => j <? n)) (acts i)
   && (negb det || forallb at_most_one (acts i))).
Fixpoint all_below k (test : nat -> bool) :=
  match k with O => true | S j => if test j then all_below j test else false end.
Definition check_certificate det := all_below n (fun i => check_row det i && check_witness det i).

(** The graph that the model describes. *)
Definition choice_avail i l := In l (choices i).
Definition choice_succ (i : nat) l (j : nat) := In (A := nat) j l.
Definition choice_edge i j := exists l, In l (choices i) /\ In j l.
End Certificate.

Definition Certificate_deterministic_statement : Prop :=
  forall n fail terminal acts label rank escape action,
  check_certificate n fail terminal acts label rank escape action true = true ->
  let edge := choice_edge fail terminal acts in forall i, i < n ->
  (label i = FAIL <-> fail i = true) /\ (label i = DEAD <-> Dead edge fail i) /\
  (label i = SAFE <-> Safe edge fail i) /\ label i <> AT_RISK /\
  (label i <> SAFE -> SurvivalTime edge fail i (rank i)).

Definition Certificate_graph_statement : Prop :=
  forall n fail terminal acts label rank escape action det,
  check_certificate n fail terminal acts label rank escape action det = true ->
  let avoidable := Avoidable (choice_avail fail terminal acts) choice_succ fail in
  let can_escape := CanEscape (choice_avail fail terminal acts) choice_succ fail in
  forall i, i < n ->
  (label i = FAIL <-> fail i = true) /\ (label i = SAFE <-> avoidable i) /\
  (label i = DEAD <-> fail i = false /\ ~ can_escape i) /\
  (label i = AT_RISK <-> can_escape i /\ ~ avoidable i).

(** The model describes the positive-probability transitions of an MDP, by numbers of states. *)
Definition Describes (M : MDP) (number : State M -> nat) n bad terminal acts :=
  forall s, number s < n /\ fail M s = bad (number s) /\
  (fail M s = false ->
   (forall a, avail M s a -> exists l, In l (choices bad terminal acts (number s)) /\
      forall j, In j l <-> exists t, succ M s a t /\ number t = j) /\
   (forall l, In l (choices bad terminal acts (number s)) -> exists a, avail M s a /\
      forall j, In j l <-> exists t, succ M s a t /\ number t = j)).

(** What the labels of an accepted certificate say of P_min(eventually fail). *)
Definition Certificate_probability_statement : Prop :=
  forall M number n bad terminal acts label rank escape action det X,
  Describes M number n bad terminal acts -> IsMinFailure M X ->
  check_certificate n bad terminal acts label rank escape action det = true ->
  forall s, (label (number s) = FAIL <-> fail M s = true) /\
  (label (number s) = SAFE <-> X s = 0%R) /\
  (label (number s) = DEAD <-> fail M s = false /\ X s = 1%R) /\
  (label (number s) = AT_RISK <-> (0 < X s < 1)%R).
