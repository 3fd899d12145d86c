(** * The extracted programs are correct. *)
From Coq Require Import List Arith Lia Bool Reals Lra.
From DeadEnds Require Import Statements Graph Stochastic CheckerStatements.
Import ListNotations.
Open Scope nat_scope.

(** ** Labelling *)
Section Labelling.
Variables (rows : list (list nat)) (bad : list bool).
Hypothesis WF : well_formed rows bad.

Let n := length rows.
Let U := seq 0 n.
Let succs i := nth i rows [].
Let fail := table_fail bad.

Lemma table_edge_iff : forall i j, table_edge rows i j <-> In j (succs i).
Proof. reflexivity. Qed.

Lemma table_in : forall i, In i U <-> i < n.
Proof. intro i. unfold U. rewrite in_seq. lia. Qed.

Lemma table_closed : forall i j, In i U -> In j (succs i) -> In j U.
Proof. intros i j Hi Hj. apply table_in. apply table_in in Hi. now apply (proj2 WF i Hi). Qed.

Lemma table_some : forall i, In i U -> succs i <> [].
Proof. intros i Hi. apply table_in in Hi. now apply WF. Qed.

Lemma nth_seq_map : forall {A} (f : nat -> A) d i, i < n -> nth i (map f U) d = f i.
Proof.
  intros A f d i Hi. rewrite nth_indep with (d' := f 0) by (unfold U; now rewrite map_length, seq_length).
  rewrite map_nth. f_equal. unfold U. now rewrite seq_nth.
Qed.

Lemma map_seq_nth : forall {A B} (f : A -> B) (l : list A) d, length l = n ->
  map f l = map (fun i => f (nth i l d)) U.
Proof.
  intros A B f l d E. unfold U. rewrite <- E. clear E. induction l as [|x l IH]; [reflexivity|].
  cbn [length seq map nth]. f_equal. rewrite IH, <- seq_shift, map_map. reflexivity.
Qed.

Lemma alive_zero : map negb bad = map (surv succs fail 0) U.
Proof.
  rewrite (map_seq_nth negb bad false) by (unfold n; apply WF).
  apply map_ext. intro i. now rewrite surv_zero.
Qed.

Lemma alive_succ : forall k,
  still_alive rows bad (map (surv succs fail k) U) = map (surv succs fail (S k)) U.
Proof.
  intro k. unfold still_alive.
  rewrite (map_seq_nth _ (combine rows bad) ([], false)).
  - apply map_ext_in. intros i Hi. rewrite combine_nth by (symmetry; apply WF). cbn [fst snd surv].
    fold (succs i). unfold fail at 2, table_fail. f_equal.
    assert (C : forall j, In j (succs i) -> j < n) by (intros j Hj; apply table_in, (table_closed i); auto).
    revert C. generalize (succs i). intro l. induction l as [|j l IH]; intro C; [reflexivity|]. cbn [existsb].
    rewrite nth_seq_map by (apply C; now left). f_equal. apply IH. intros x Hx. apply C. now right.
  - rewrite combine_length. pose proof (proj1 WF) as E. unfold n. lia.
Qed.

(** The first round before [k] in which a state is no longer alive. *)
Fixpoint before k i : option nat :=
  match k with O => None | S j => note j (before j i, surv succs fail j i) end.

Lemma note_before : forall k,
  map (note k) (combine (map (before k) U) (map (surv succs fail k) U)) = map (before (S k)) U.
Proof.
  intro k. generalize U. intro l. induction l as [|i l IH]; [reflexivity|]. cbn [map combine]. now rewrite IH.
Qed.

Lemma rounds_spec : forall fuel k,
  rounds rows bad fuel k (map (surv succs fail k) U) (map (before k) U) = map (before (k + fuel)) U.
Proof.
  induction fuel as [|f IH]; intro k; cbn [rounds].
  - now rewrite Nat.add_0_r.
  - rewrite alive_succ, note_before, IH. now rewrite Nat.add_succ_r.
Qed.

Lemma survival_spec : survival_times rows bad = map (before (S n)) U.
Proof.
  unfold survival_times. rewrite alive_zero. rewrite (map_seq_nth (fun _ => None) rows []) by reflexivity.
  change (map (fun _ => None) U) with (map (before 0) U). now rewrite rounds_spec.
Qed.

Lemma before_some : forall k i t, before k i = Some t <-> t < k /\ lasts succs fail t i.
Proof.
  induction k as [|k IH]; intros i t; cbn [before]; [split; [discriminate|lia]|].
  unfold note. cbn [fst snd]. destruct (before k i) as [u|] eqn:E.
  - apply IH in E. destruct E as [Hu Lu]. split.
    + intro X. injection X as <-. split; [lia|exact Lu].
    + intros [_ Lt]. now rewrite (lasts_fun succs fail _ _ _ Lu Lt).
  - assert (N : forall u, u < k -> ~ lasts succs fail u i)
      by (intros u Hu L; assert (X : before k i = Some u) by (apply IH; auto); congruence).
    destruct (surv succs fail k i) eqn:Sk.
    + split; [discriminate|]. intros [Ht Lt]. destruct (Nat.eq_dec t k) as [->|Ne].
      * destruct Lt as [Lt _]. congruence.
      * exfalso. apply (N t); auto. lia.
    + destruct (lasts_exists succs fail k i Sk) as [u [Hu Lu]].
      assert (u = k) by (destruct (Nat.eq_dec u k); auto; exfalso; apply (N u); auto; lia). subst u.
      split.
      * intro X. injection X as <-. split; [lia|exact Lu].
      * intros [_ Lt]. now rewrite (lasts_fun succs fail _ _ _ Lu Lt).
Qed.

Lemma time_spec : forall i k, i < n ->
  SurvivalTime (table_edge rows) fail i k <-> nth i (survival_times rows bad) None = Some k.
Proof.
  intros i k Hi. assert (Ui : In i U) by now apply table_in.
  rewrite survival_spec, nth_seq_map, before_some by auto.
  rewrite (time_iff succs (table_edge rows) fail U table_edge_iff table_closed table_some k i Ui).
  split; [|tauto]. intro L. split; auto.
  pose proof (lasts_bound succs fail U table_closed table_some k i Ui L) as B.
  unfold U in B. rewrite seq_length in B. lia.
Qed.
End Labelling.

Theorem Labelling : Labelling_statement.
Proof.
  intros rows bad i WF Hi. cbv zeta.
  assert (Ui : In i (seq 0 (length rows))) by (apply in_seq; lia).
  pose proof (fun k => time_spec rows bad WF i k Hi) as T.
  pose proof (table_closed rows bad WF) as Cl. pose proof (table_some rows bad WF) as So.
  pose proof (time_finite _ _ (table_fail bad) _ (table_edge_iff rows) Cl So i Ui) as Fin.
  split; [|split; [|split]].
  - rewrite (safe_iff _ _ (table_fail bad) _ (table_edge_iff rows) Cl So i Ui).
    pose proof (safeb_lasts _ (table_fail bad) _ Cl So i Ui) as SL.
    destruct (nth i (survival_times rows bad) None) as [k|] eqn:E.
    + split; [|discriminate]. intro H. exfalso. apply (proj1 Fin (ex_intro _ k (proj2 (T k) eq_refl))).
      now apply (safe_iff _ _ (table_fail bad) _ (table_edge_iff rows) Cl So i Ui).
    + split; auto. intros _. destruct (safeb _ (table_fail bad) _ i) eqn:S; auto. exfalso.
      destruct (proj1 SL eq_refl) as [k L].
      apply (time_iff _ _ (table_fail bad) _ (table_edge_iff rows) Cl So k i Ui) in L. apply T in L. congruence.
  - rewrite <- (T 0). symmetry. apply (time_zero _ _ (table_fail bad) _ (table_edge_iff rows) Cl So i Ui).
  - rewrite (dead_time _ _ (table_fail bad) _ (table_edge_iff rows) Cl So i Ui).
    split; intros [k H]; exists k; now apply T.
  - exact T.
Qed.

(** ** Certificates *)
Lemma all_below_spec : forall k test, all_below k test = true -> forall i, i < k -> test i = true.
Proof.
  induction k as [|k IH]; intros test H i Hi; [lia|]. cbn in H. destruct (test k) eqn:E; [|discriminate].
  destruct (Nat.eq_dec i k) as [->|]; auto. apply IH; auto. lia.
Qed.

Section Certificate.
Variables (n : nat) (fail terminal : nat -> bool) (acts : nat -> list (list nat)).
Variables (label : nat -> Label) (rank escape : nat -> nat) (action : nat -> option nat) (det : bool).
Hypothesis Accepted : check_certificate n fail terminal acts label rank escape action det = true.

Let options := choices fail terminal acts.
Let avoidable := Avoidable (choice_avail fail terminal acts) choice_succ fail.
Let can_escape := CanEscape (choice_avail fail terminal acts) choice_succ fail.

Lemma row_ok : forall i, i < n -> check_row n fail terminal acts det i = true.
Proof. intros i Hi. pose proof (all_below_spec _ _ Accepted i Hi) as H. now apply andb_prop in H. Qed.

Lemma witness_ok : forall i, i < n -> check_witness fail terminal acts label rank escape action det i = true.
Proof. intros i Hi. pose proof (all_below_spec _ _ Accepted i Hi) as H. now apply andb_prop in H. Qed.

Lemma options_some : forall i l, In l (options i) -> l <> [].
Proof.
  intros i l H. unfold options, choices in H. destruct (fail i || terminal i).
  - destruct H as [<-|[]]. discriminate.
  - apply filter_In in H. destruct H as [_ H]. intros ->. discriminate.
Qed.

Lemma options_closed : forall i l j, i < n -> In l (options i) -> In j l -> j < n.
Proof.
  intros i l j Hi Hl Hj. pose proof (row_ok i Hi) as R. unfold check_row in R.
  unfold options, choices in Hl. destruct (fail i || terminal i).
  - destruct Hl as [<-|[]]. destruct Hj as [<-|[]]. exact Hi.
  - cbn in R. apply andb_prop in R. destruct R as [R _]. apply andb_prop in R. destruct R as [_ R].
    rewrite forallb_forall in R. apply filter_In in Hl. specialize (R l (proj1 Hl)).
    rewrite forallb_forall in R. now apply Nat.ltb_lt, R.
Qed.

Lemma options_exist : forall i, i < n -> exists l, In l (options i).
Proof.
  intros i Hi. pose proof (row_ok i Hi) as R. unfold check_row in R. unfold options, choices.
  destruct (fail i || terminal i); [exists [i]; now left|].
  cbn in R. apply andb_prop in R. destruct R as [R _]. apply andb_prop in R. destruct R as [R _].
  apply existsb_exists in R. destruct R as [l [Hl Ne]]. exists l. apply filter_In. auto.
Qed.

Lemma chosen_option : forall i a, fail i = false -> chosen terminal acts i a <> [] ->
  In (chosen terminal acts i a) (options i).
Proof.
  intros i a Hf Ne. unfold chosen, options, choices in *. rewrite Hf, orb_false_l.
  destruct (terminal i).
  - destruct (a <? length (acts i)); [now left|congruence].
  - apply filter_In. split.
    + destruct (nth_in_or_default a (acts i) []) as [|E]; auto. congruence.
    + destruct (nth a (acts i) []); [congruence|reflexivity].
Qed.

Ltac split_ands :=
  repeat match goal with H : _ && _ = true |- _ => apply andb_prop in H; destruct H end.

(** What acceptance says at a state, label by label. *)
Lemma at_fail : forall i, i < n -> (label i = FAIL <-> fail i = true).
Proof.
  intros i Hi. pose proof (witness_ok i Hi) as W. unfold check_witness in W.
  destruct (label i), (action i); try discriminate; split_ands;
    repeat match goal with H : negb _ = true |- _ => apply negb_true_iff in H end;
    split; intro; congruence.
Qed.

Lemma at_rank_zero : forall i, i < n -> label i = FAIL -> rank i = 0.
Proof.
  intros i Hi E. pose proof (witness_ok i Hi) as W. unfold check_witness in W. rewrite E in W.
  destruct (action i); [discriminate|]. split_ands. now apply Nat.eqb_eq.
Qed.

Lemma at_safe : forall i, i < n -> label i = SAFE ->
  exists l, In l (options i) /\ l <> [] /\ forall j, In j l -> label j = SAFE.
Proof.
  intros i Hi E. pose proof (witness_ok i Hi) as W. unfold check_witness in W. rewrite E in W.
  destruct (action i) as [a|]; [|discriminate]. split_ands. unfold stays in *.
  assert (Ne : chosen terminal acts i a <> []).
  { intro X. rewrite X in *. discriminate. }
  split_ands.
  exists (chosen terminal acts i a). split; [apply chosen_option; auto; now apply negb_true_iff|].
  split; auto. intros j Hj.
  assert (A : forallb (safe_label label) (chosen terminal acts i a) = true) by assumption.
  rewrite forallb_forall in A. specialize (A j Hj). unfold safe_label in A.
  destruct (label j); auto; discriminate.
Qed.

Lemma at_doomed : forall i, i < n -> label i = DEAD -> forall l j, In l (options i) -> In j l ->
  label j = FAIL \/ label j = DEAD.
Proof.
  intros i Hi E l j Hl Hj. pose proof (witness_ok i Hi) as W. unfold check_witness in W. rewrite E in W.
  destruct (action i); [discriminate|]. split_ands.
  assert (A : doomed fail terminal acts label i = true) by assumption. unfold doomed in A.
  rewrite forallb_forall in A. specialize (A l Hl). rewrite forallb_forall in A. specialize (A j Hj).
  unfold doomed_label in A. destruct (label j); auto; discriminate.
Qed.

Lemma at_danger : forall i, i < n -> label i = DEAD \/ label i = AT_RISK ->
  forall l, In l (options i) -> exists j, In j l /\ label j <> SAFE /\ rank j < rank i.
Proof.
  intros i Hi E l Hl. pose proof (witness_ok i Hi) as W. unfold check_witness in W.
  assert (D : dangerous fail terminal acts label rank i = true).
  { destruct (label i), (action i); try discriminate; split_ands; auto; destruct E; discriminate. }
  unfold dangerous in D. rewrite forallb_forall in D. specialize (D l Hl).
  apply existsb_exists in D. destruct D as [j [Hj D]]. apply andb_prop in D. destruct D as [Un Lt].
  exists j. split; auto. split; [|now apply Nat.ltb_lt].
  intro X. unfold unsafe_label in Un. rewrite X in Un. discriminate.
Qed.

Lemma at_risk_nears : forall i, i < n -> label i = AT_RISK -> exists l j, In l (options i) /\ In j l /\
  (label j = SAFE \/ label j = AT_RISK) /\ escape j < escape i.
Proof.
  intros i Hi E. pose proof (witness_ok i Hi) as W. unfold check_witness in W. rewrite E in W.
  destruct (action i) as [a|]; [|discriminate]. split_ands.
  assert (A : nears terminal acts label escape i a = true) by assumption.
  apply existsb_exists in A. destruct A as [j [Hj N]]. apply andb_prop in N. destruct N as [Ld Lt].
  exists (chosen terminal acts i a), j. split; [|split; [auto|split]].
  - apply chosen_option; [now apply negb_true_iff|]. intro X. rewrite X in Hj. exact Hj.
  - unfold doomed_label in Ld. destruct (label j); auto; discriminate.
  - now apply Nat.ltb_lt.
Qed.

(** ** What the labels mean on the graph *)
Lemma safe_avoidable : forall i, i < n -> label i = SAFE -> avoidable i.
Proof.
  intros i Hi E. exists (fun j => j < n /\ label j = SAFE). split; auto. intros j [Hj Ej]. split.
  - destruct (fail j) eqn:F; auto. apply at_fail in F; auto. congruence.
  - destruct (at_safe j Hj Ej) as [l [Hl [_ A]]]. exists l. split; [exact Hl|].
    intros u Hu. split; [now apply (options_closed j l)|now apply A].
Qed.

Lemma unsafe_unavoidable : forall r i, rank i <= r -> i < n -> label i <> SAFE -> ~ avoidable i.
Proof.
  induction r as [|r IH]; intros i Hr Hi E [Z [Zi HZ]]; destruct (HZ i Zi) as [Hf [l [Hl A]]].
  - destruct (label i) eqn:L; try congruence.
    + apply at_fail in L; auto. congruence.
    + destruct (at_danger i Hi (or_introl L) l Hl) as [j [_ [_ X]]]. lia.
    + destruct (at_danger i Hi (or_intror L) l Hl) as [j [_ [_ X]]]. lia.
  - assert (D : label i = DEAD \/ label i = AT_RISK).
    { destruct (label i) eqn:L; auto; try congruence. apply at_fail in L; auto. congruence. }
    destruct (at_danger i Hi D l Hl) as [j [Hj [Nj Rj]]].
    apply (IH j); [lia|now apply (options_closed i l)|auto|]. exists Z. split; auto.
Qed.

Lemma label_avoidable : forall i, i < n -> (label i = SAFE <-> avoidable i).
Proof.
  intros i Hi. split; [now apply safe_avoidable|]. intro A.
  destruct (label i) eqn:E; auto; exfalso; apply (unsafe_unavoidable (rank i) i); auto; congruence.
Qed.

Lemma risk_escapes : forall e i, escape i <= e -> i < n -> label i = AT_RISK -> can_escape i.
Proof.
  induction e as [|e IH]; intros i He Hi E; destruct (at_risk_nears i Hi E) as [l [j [Hl [Hj [Lj Ej]]]]];
    [lia|].
  assert (Hn : j < n) by now apply (options_closed i l).
  apply (escape_step _ _ _ i l j); auto.
  - destruct (fail i) eqn:F; auto. apply at_fail in F; auto. congruence.
  - destruct Lj as [Lj|Lj].
    + apply escape_now. now apply safe_avoidable.
    + apply IH; auto. lia.
Qed.

Lemma escape_label : forall i, can_escape i -> i < n -> label i = SAFE \/ label i = AT_RISK.
Proof.
  intros i H. induction H as [i A|i l j Hf Hl Hj _ IH]; intro Hi.
  - left. now apply label_avoidable.
  - pose proof (IH (options_closed i l j Hi Hl Hj)) as Lj.
    destruct (label i) eqn:E; auto; exfalso.
    + apply at_fail in E; auto. congruence.
    + destruct (at_doomed i Hi E l j Hl Hj); destruct Lj; congruence.
Qed.

Lemma label_dead : forall i, i < n -> (label i = DEAD <-> fail i = false /\ ~ can_escape i).
Proof.
  intros i Hi. split.
  - intro E. split.
    + destruct (fail i) eqn:F; auto. apply at_fail in F; auto. congruence.
    + intro C. destruct (escape_label i C Hi); congruence.
  - intros [Hf C]. destruct (label i) eqn:E; auto; exfalso.
    + apply at_fail in E; auto. congruence.
    + apply C, escape_now. now apply safe_avoidable.
    + apply C. now apply (risk_escapes (escape i)).
Qed.

Lemma label_risk : forall i, i < n -> (label i = AT_RISK <-> can_escape i /\ ~ avoidable i).
Proof.
  intros i Hi. split.
  - intro E. split; [now apply (risk_escapes (escape i))|]. intro A. apply label_avoidable in A; auto. congruence.
  - intros [C A]. destruct (escape_label i C Hi) as [E|E]; auto. exfalso. apply A. now apply label_avoidable.
Qed.

(** ** Deterministic models: ranks are survival times *)
Section Deterministic.
Hypothesis Det : det = true.

Let edge := choice_edge fail terminal acts.
Let U := seq 0 n.
Let succs i := concat (options i).

Lemma choice_edge_iff : forall i j, edge i j <-> In j (succs i).
Proof.
  intros i j. unfold succs. rewrite in_concat. split; intros [l H]; exists l; tauto.
Qed.

Lemma in_U : forall i, In i U <-> i < n.
Proof. intro i. unfold U. rewrite in_seq. lia. Qed.

Lemma choice_closed : forall i j, In i U -> In j (succs i) -> In j U.
Proof.
  intros i j Hi Hj. apply choice_edge_iff in Hj. destruct Hj as [l [Hl Hj]].
  apply in_U. apply in_U in Hi. now apply (options_closed i l).
Qed.

Lemma choice_some : forall i, In i U -> succs i <> [].
Proof.
  intros i Hi E. apply in_U in Hi. destruct (options_exist i Hi) as [l Hl].
  pose proof (options_some i l Hl). destruct l as [|j l]; [congruence|].
  assert (X : In j (succs i)) by (apply in_concat; exists (j :: l); split; [exact Hl|now left]).
  rewrite E in X. exact X.
Qed.

Lemma single : forall i l, i < n -> In l (options i) -> exists j, l = [j].
Proof.
  intros i l Hi Hl. pose proof (options_some i l Hl) as Ne.
  pose proof (row_ok i Hi) as R. unfold check_row in R. rewrite Det in R. unfold options, choices in Hl.
  destruct (fail i || terminal i).
  - destruct Hl as [<-|[]]. eauto.
  - rewrite orb_false_l in R. split_ands. apply filter_In in Hl.
    assert (A : forallb at_most_one (acts i) = true) by assumption.
    rewrite forallb_forall in A. specialize (A l (proj1 Hl)). destruct l as [|j [|k l]]; [congruence|eauto|discriminate].
Qed.

Lemma no_risk : forall i, i < n -> label i <> AT_RISK.
Proof.
  intros i Hi E. pose proof (witness_ok i Hi) as W. unfold check_witness in W. rewrite E, Det in W.
  destruct (action i); discriminate.
Qed.

Lemma at_tight : forall i, i < n -> label i = DEAD -> exists j, edge i j /\ S (rank j) = rank i.
Proof.
  intros i Hi E. pose proof (witness_ok i Hi) as W. unfold check_witness in W. rewrite E, Det in W.
  destruct (action i); [discriminate|]. split_ands.
  assert (A : tight fail terminal acts rank i = true) by assumption.
  apply existsb_exists in A. destruct A as [l [Hl T]]. destruct (single i l Hi Hl) as [j ->].
  exists j. split; [exists [j]; split; [exact Hl|now left]|]. cbn in T. split_ands. now apply Nat.eqb_eq.
Qed.

Lemma dead_successor : forall i j, i < n -> label i = DEAD -> edge i j ->
  (label j = FAIL \/ label j = DEAD) /\ rank j < rank i.
Proof.
  intros i j Hi E [l [Hl Hj]]. split; [now apply (at_doomed i Hi E l j)|].
  destruct (single i l Hi Hl) as [k ->]. destruct Hj as [<-|[]].
  destruct (at_danger i Hi (or_introl E) [k] Hl) as [u [[<-|[]] [_ R]]]. exact R.
Qed.

Lemma rank_time : forall r i, rank i <= r -> i < n -> label i = FAIL \/ label i = DEAD ->
  SurvivalTime edge fail i (rank i).
Proof.
  induction r as [r IH] using lt_wf_ind. intros i Hr Hi [E|E].
  - rewrite (at_rank_zero i Hi E).
    apply (time_zero succs edge fail U choice_edge_iff choice_closed choice_some i); [now apply in_U|].
    now apply at_fail.
  - destruct (at_tight i Hi E) as [k [Ek Tk]]. rewrite <- Tk.
    assert (T : forall j, edge i j -> SurvivalTime edge fail j (rank j)).
    { intros j Ej. destruct (dead_successor i j Hi E Ej) as [Lj Rj].
      apply (IH (rank j)); auto; [lia|]. destruct Ej as [l [Hl Hj]]. now apply (options_closed i l). }
    apply (time_succ succs edge fail U choice_edge_iff choice_closed choice_some); [now apply in_U|].
    split; [now apply label_dead|]. split; [|eauto]. intros j Ej.
    destruct (dead_successor i j Hi E Ej) as [_ Rj]. exists (rank j). split; [lia|auto].
Qed.

Lemma avoidable_safe : forall i, i < n -> label i = SAFE -> Safe edge fail i.
Proof.
  intros i Hi E.
  assert (Step : forall j, j < n /\ label j = SAFE -> exists k, edge j k /\ k < n /\ label k = SAFE).
  { intros j [Hj Ej]. destruct (at_safe j Hj Ej) as [l [Hl [Ne A]]]. destruct l as [|k l]; [congruence|].
    exists k. split; [exists (k :: l); split; [exact Hl|now left]|]. split; [|apply A; now left].
    apply (options_closed j (k :: l)); auto. now left. }
  apply (safe_iff succs edge fail U choice_edge_iff choice_closed choice_some i); [now apply in_U|].
  destruct (safeb succs fail U i) eqn:Sb; auto. exfalso.
  apply (safeb_lasts succs fail U choice_closed choice_some i) in Sb; [|now apply in_U].
  destruct Sb as [m L]. revert i Hi E L. induction m as [m IH] using lt_wf_ind. intros i Hi E L.
  destruct m as [|m].
  - apply lasts_zero in L. apply at_fail in L; auto. congruence.
  - apply (lasts_succ succs fail U choice_some) in L; [|now apply in_U]. destruct L as [_ [A _]].
    destruct (Step i (conj Hi E)) as [k [Ek [Hk Lk]]]. apply choice_edge_iff in Ek.
    destruct (A k Ek) as [t [Ht Lt]]. apply (IH t) with (i := k); auto. lia.
Qed.

Lemma deterministic_labels : forall i, i < n ->
  (label i = FAIL <-> fail i = true) /\ (label i = DEAD <-> Dead edge fail i) /\
  (label i = SAFE <-> Safe edge fail i) /\ label i <> AT_RISK /\
  (label i <> SAFE -> SurvivalTime edge fail i (rank i)).
Proof.
  intros i Hi.
  assert (T : label i <> SAFE -> SurvivalTime edge fail i (rank i)).
  { intro N. apply (rank_time (rank i)); auto. pose proof (no_risk i Hi). destruct (label i); auto; congruence. }
  assert (NS : label i <> SAFE -> ~ Safe edge fail i).
  { intro N. apply (time_finite succs edge fail U choice_edge_iff choice_closed choice_some); [now apply in_U|].
    eauto. }
  assert (Sf : label i = SAFE -> Safe edge fail i) by now apply avoidable_safe.
  pose proof (at_fail i Hi) as F. pose proof (no_risk i Hi) as NR.
  pose proof (partition succs edge fail U choice_edge_iff choice_closed choice_some i (proj2 (in_U i) Hi)) as P.
  split; [exact F|]. split; [|split; [|split; [exact NR|exact T]]].
  - split.
    + intro E. assert (fail i = false) by now apply label_dead.
      destruct P as [X|[X|X]]; auto; [congruence|]. exfalso. apply NS; auto. congruence.
    + intros [Hf Dd]. destruct (label i) eqn:E; auto; try congruence.
      * assert (fail i = true) by now apply F. congruence.
      * destruct (Sf eq_refl) as [_ X]. exfalso. apply X. now split.
  - split; [exact Sf|]. intro X. destruct (label i) eqn:E; auto; exfalso; apply NS; auto; congruence.
Qed.
End Deterministic.
End Certificate.

Theorem Certificate_deterministic : Certificate_deterministic_statement.
Proof.
  intros n fl terminal acts label rank escape action H edge.
  exact (deterministic_labels n fl terminal acts label rank escape action true H eq_refl).
Qed.

Theorem Certificate_graph : Certificate_graph_statement.
Proof.
  intros n fl terminal acts label rank escape action det H avoidable can_escape i Hi.
  split; [exact (at_fail _ _ _ _ _ _ _ _ _ H i Hi)|].
  split; [exact (label_avoidable _ _ _ _ _ _ _ _ _ H i Hi)|].
  split; [exact (label_dead _ _ _ _ _ _ _ _ _ H i Hi)|exact (label_risk _ _ _ _ _ _ _ _ _ H i Hi)].
Qed.

(** ** From the numbered graph to the MDP that it describes *)
Section Described.
Variables (M : MDP) (number : State M -> nat) (n : nat) (bad terminal : nat -> bool).
Variable acts : nat -> list (list nat).
Hypothesis Desc : Describes M number n bad terminal acts.

Let numbered := choice_avail bad terminal acts.

Lemma described_avoidable : forall s, Avoidable numbered choice_succ bad (number s) <->
  Avoidable (avail M) (succ M) (fail M) s.
Proof.
  intro s. split.
  - intros [Z [Zs HZ]]. exists (fun t => Z (number t)). split; auto. intros t Zt.
    destruct (HZ _ Zt) as [Hf [l [Hl A]]]. destruct (Desc t) as [_ [Ef Match]].
    rewrite <- Ef in Hf. split; auto. destruct (proj2 (Match Hf) l Hl) as [a [Ha E]].
    exists a. split; auto. intros u Hu. apply A. apply E. eauto.
  - intros [Z [Zs HZ]]. exists (fun j => exists t, Z t /\ number t = j). split; [eauto|].
    intros j [t [Zt <-]]. destruct (HZ t Zt) as [Hf [a [Ha A]]]. destruct (Desc t) as [_ [Ef Match]].
    rewrite <- Ef. split; auto. destruct (proj1 (Match Hf) a Ha) as [l [Hl E]].
    exists l. split; auto. intros u Hu. apply E in Hu. destruct Hu as [v [Hv <-]]. eauto.
Qed.

Lemma described_escape : forall s, CanEscape numbered choice_succ bad (number s) <->
  CanEscape (avail M) (succ M) (fail M) s.
Proof.
  intro s. split.
  - intro H. remember (number s) as j eqn:E. revert s E.
    induction H as [j A|j l k Hf Hl Hk _ IH]; intros s ->.
    + apply escape_now. now apply described_avoidable.
    + destruct (Desc s) as [_ [Ef Match]]. rewrite <- Ef in Hf.
      destruct (proj2 (Match Hf) l Hl) as [a [Ha E]]. apply E in Hk. destruct Hk as [t [Ht Et]].
      apply (escape_step _ _ _ s a t); auto.
  - intro H. induction H as [s A|s a t Hf Ha Ht _ IH].
    + apply escape_now. now apply described_avoidable.
    + destruct (Desc s) as [_ [Ef Match]]. destruct (proj1 (Match Hf) a Ha) as [l [Hl E]].
      apply (escape_step _ _ _ (number s) l (number t)); auto; [congruence|]. apply E. eauto.
Qed.
End Described.

Theorem Certificate_probability : Certificate_probability_statement.
Proof.
  intros M number n bad terminal acts label rank escape action det X Desc HX H s.
  destruct (Desc s) as [Hs [Ef _]].
  destruct (Certificate_graph n bad terminal acts label rank escape action det H (number s) Hs)
    as [F [Sf [Dd Rk]]].
  rewrite (described_avoidable M number n bad terminal acts Desc) in Sf, Rk.
  rewrite (described_escape M number n bad terminal acts Desc) in Dd, Rk.
  rewrite <- (zero_avoidable M X HX s) in Sf, Rk. rewrite <- (below_one_escape M X HX s) in Dd, Rk.
  rewrite Ef. pose proof (X_range M X HX s) as B.
  split; [exact F|]. split; [exact Sf|]. split.
  - rewrite Dd. split; intros [Hf L]; split; auto; lra.
  - rewrite Rk. split; lra.
Qed.
