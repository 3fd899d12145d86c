(** * The claim that RRL too keeps out of dead-ends is false.

    Five states: P -first-> D2 -> D1 -> Fail, P -second-> Turn, and in Turn the first
    action fails, the second stays.  The untrained task policy takes the first action.
    Its critic sees failure two steps later through D2 (gamma^2) than through Turn
    (gamma): both the gate and the recovery choose D2, although Turn is safe. *)
From Coq Require Import List Reals Lra Lia.
From DeadEnds Require Import Statements Sums FixedPoint Values Labels Deterministic.
Import ListNotations.
Open Scope R_scope.

(** A deterministic model from its successor function. *)
Definition table (St Act : Type) (all : list St) (complete : forall s, In s all)
    (acts : St -> list Act) (some : forall s, acts s <> []) (next : St -> Act -> St) (bad : St -> bool) : MDP :=
  {| State := St; Action := Act; states := all; states_all := complete; actions := acts;
     actions_some := some; step := fun s a => dirac (next s a);
     step_dist := fun s a => dirac_dist (next s a); fail := bad |}.

Inductive Place := Fail | D1 | D2 | P | Turn.
Definition places := [Fail; D1; D2; P; Turn].
Lemma places_all : forall s, In s places. Proof. intros []; cbn; tauto. Qed.
Definition both (_ : Place) := [true; false].
Lemma both_some : forall s, both s <> []. Proof. discriminate. Qed.
Definition move (s : Place) (first : bool) : Place :=
  match s, first with
  | P, true => D2 | P, false => Turn | Turn, true => Fail | Turn, false => Turn
  | D2, _ => D1 | D1, _ => Fail | Fail, _ => Fail
  end.
Definition is_fail s := match s with Fail => true | _ => false end.
Definition five : MDP := table Place bool places places_all both both_some move is_fail.
Definition task (s : State five) : Action five := true.

Lemma five_det : Deterministic five move.
Proof. intros s a. reflexivity. Qed.

Lemma five_avail : forall s a, avail five s a.
Proof. intros s []; cbn; tauto. Qed.

Lemma task_policy : IsPolicy five (pure five task).
Proof. apply pure_policy. intro s. apply five_avail. Qed.

Lemma five_edge : forall s t, edge five s t -> exists a, t = move s a.
Proof. intros s t H. apply (edge_next five move five_det) in H. destruct H as [a [_ E]]. eauto. Qed.

Lemma move_edge : forall s a, edge five s (move s a).
Proof. intros s a. apply (edge_next five move five_det). exists a. split; auto. apply five_avail. Qed.

Lemma turn_safe : safe five Turn.
Proof.
  apply safe_path. exists (fun _ => Turn). split; [|split; reflexivity].
  intro i. exact (move_edge Turn false).
Qed.

Lemma p_safe : safe five P.
Proof.
  apply safe_path. exists (fun i => match i with O => P | _ => Turn end). split; [|split].
  - intros [|i]; [exact (move_edge P false)|exact (move_edge Turn false)].
  - reflexivity.
  - intros [|k]; reflexivity.
Qed.

Lemma d1_time : time five D1 1.
Proof.
  apply time_succ. split; [reflexivity|]. split.
  - intros t E. apply five_edge in E. destruct E as [a ->]. exists 0%nat. split; [lia|]. now apply time_zero.
  - exists Fail. split; [exact (move_edge D1 true)|]. now apply time_zero.
Qed.

Lemma d2_time : time five D2 2.
Proof.
  apply time_succ. split; [reflexivity|]. split.
  - intros t E. apply five_edge in E. destruct E as [a ->]. exists 1%nat. split; [lia|]. exact d1_time.
  - exists D1. split; [exact (move_edge D2 true)|exact d1_time].
Qed.

Lemma d2_dead : dead five D2.
Proof. apply dead_time. exists 1%nat. exact d2_time. Qed.

Lemma five_boundary : BoundaryHorizon five 2.
Proof.
  split.
  - exists P, D2. split; [exact p_safe|]. split; [exact (move_edge P true)|exact d2_time].
  - intros s t n Hs E T. apply five_edge in E. destruct E as [a ->].
    assert (A : forall u m, time five u m -> u = Fail \/ u = D1 \/ u = D2 -> (m <= 2)%nat).
    { intros u m Tu [E|[E|E]]; subst u.
      - rewrite (time_fun five m 0 Fail Tu); [lia|]. now apply time_zero.
      - rewrite (time_fun five m 1 D1 Tu d1_time). lia.
      - rewrite (time_fun five m 2 D2 Tu d2_time). lia. }
    destruct s, a; try (apply (A _ _ T); cbn; tauto).
    + exfalso. exact (safe_no_time five Turn n turn_safe T).
    + exfalso. exact (safe_no_time five Turn n turn_safe T).
Qed.

(** ** Every minimiser of Q^pi_task in P leads into D2, whatever the discount. *)
Section Critic.
Variables (gamma vf : R) (V : Place -> R).
Hypothesis D : Discount gamma vf.
Hypothesis HV : IsValue five gamma vf (pure five task) V.

Lemma task_value : forall s, is_fail s = false -> V s = target five gamma V (move s true).
Proof.
  intros s Hf. apply (value_iff five gamma vf D _ task_policy) in HV. destruct HV as [_ E].
  rewrite E. unfold backup. cbn [fail five table]. rewrite Hf. unfold pure. rewrite expect_dirac.
  apply (Q_next five move five_det).
Qed.

Lemma critic_p : Q five gamma V P true = gamma * gamma /\ Q five gamma V P false = gamma.
Proof.
  rewrite !(Q_next five move five_det). unfold target. cbn [fail five table move is_fail].
  rewrite (task_value D2 eq_refl), (task_value Turn eq_refl). cbn [move]. unfold target.
  cbn [fail five table is_fail]. rewrite (task_value D1 eq_refl). unfold target. cbn. split; ring.
Qed.

Lemma rrl_first : forall eps b,
  Executes five (Q five gamma V) (Q five gamma V) eps P (task P) b -> b = true.
Proof.
  intros eps b [[_ E]|[_ [_ L]]]; [exact E|]. destruct b; [reflexivity|]. exfalso.
  destruct critic_p as [Qt Qf]. specialize (L true (five_avail P true)). rewrite Qt, Qf in L.
  destruct D as [G _]. nra.
Qed.
End Critic.

(** The corrected action of some agent, so that closed loops exist. *)
Definition executed (M : MDP) gate recovery eps (propose : State M -> Action M) s : Action M :=
  if Rlt_dec (gate s (propose s)) eps then propose s else greedy M recovery s.

Lemma executed_executes : forall M gate recovery eps propose s,
  Executes M gate recovery eps s (propose s) (executed M gate recovery eps propose s).
Proof.
  intros M gate recovery eps propose s. unfold executed. destruct (Rlt_dec _ eps) as [L|L].
  - left. auto.
  - right. split; [lra|apply greedy_argmin].
Qed.

Lemma loop_exists : forall M next gate recovery eps propose s, Deterministic M next ->
  (forall t, avail M t (propose t)) -> exists w, w 0%nat = s /\ ClosedLoop M gate recovery eps w /\
  w 1%nat = next s (executed M gate recovery eps propose s).
Proof.
  intros M next gate recovery eps propose s Det Hp.
  exists (fun n => Nat.iter n (fun t => next t (executed M gate recovery eps propose t)) s).
  split; [reflexivity|]. split; [|reflexivity]. intro i.
  set (t := Nat.iter i _ s). exists (propose t), (executed M gate recovery eps propose t).
  split; auto. split; [apply executed_executes|]. now apply (succ_next M next Det).
Qed.

Theorem rrl_refuted : RRL_refuted_statement.
Proof.
  split.
  - intro Claim. assert (D : Discount (1/2) 0) by (split; lra).
    destruct (value_exists five (1/2) 0 D _ task_policy) as [V HV].
    destruct (loop_exists five move (Q five (1/2) V) (Q five (1/2) V) (1/4) task P five_det) as [w [W0 [C W1]]].
    { intro t. apply five_avail. }
    assert (S : safe five (w 1%nat)).
    { apply (Claim five move (1/2) 0 (pure five task) V (Vstar five (1/2) 0 D) (1/4)); auto; [|lra| |].
      - exact (conj D (conj five_det (conj task_policy (conj HV (Vstar_optimal five (1/2) 0 D))))).
      - apply (threshold_boundary five (1/2) (1/4) 2); [lra|exact five_boundary|lra].
      - rewrite W0. exact p_safe. }
    rewrite W1 in S.
    rewrite (rrl_first (1/2) 0 V D HV (1/4) _ (executed_executes five _ _ _ task P)) in S.
    destruct S as [_ S]. apply S, d2_dead.
  - exists five, move, task, P. split; [exact five_det|]. split; [reflexivity|].
    split; [exact task_policy|]. split; [exact p_safe|]. intros gamma vf eps V D HV. split.
    + exists (executed five (Q five gamma V) (Q five gamma V) eps task P). apply executed_executes.
    + intros b Hb. rewrite (rrl_first gamma vf V D HV eps b Hb). exact d2_dead.
Qed.
