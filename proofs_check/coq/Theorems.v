(** * Each statement of Statements.v, proved, under its name: [X : X_statement]. *)
From Coq Require Import List Reals.
From DeadEnds Require Import Statements Sums FixedPoint Values Labels Deterministic
  RRLCounterexample Expectile Stochastic StochasticCounterexample.
Open Scope R_scope.

Theorem Partition : Partition_statement.
Proof.
  intros M s. split; [apply label_cases|]. split; [apply Labels.safe_path|apply safe_succ].
Qed.

Theorem Horizon : Horizon_statement.
Proof. intros M D s. apply dead_horizon. Qed.

Theorem Acyclic : Acyclic_statement.
Proof. intros M w i j. apply dead_no_cycle. Qed.

Theorem SurvivalTime : SurvivalTime_statement.
Proof.
  intros M s. split; [apply Labels.time_finite|]. split; [apply Labels.time_zero|].
  intro n. apply Labels.time_succ.
Qed.

Theorem MemorylessDead : MemorylessDead_statement.
Proof. intros M next Det s. apply memoryless_dead with (gamma := 1/2) (vf := 0); auto. split; Lra.lra. Qed.

Theorem Threshold : Threshold_statement.
Proof.
  intros M gamma eps Hg. split; [apply boundary_cases|].
  split; [intros h Hh; now apply threshold_boundary|].
  split; [apply threshold_free|]. intros H. now apply threshold_horizon.
Qed.

Theorem Value_exists : Value_exists_statement.
Proof.
  intros M gamma vf pi D Hpi. destruct (value_exists M gamma vf D pi Hpi) as [V HV].
  exists V. split; auto. intro V'. now apply value_iff.
Qed.

Theorem Optimal_exists : Optimal_exists_statement.
Proof.
  intros M gamma vf D. exists (Vstar M gamma vf D). split; [apply Vstar_optimal|].
  intro V'. now apply optimal_iff.
Qed.

Theorem Lemma1_bullet1 : Lemma1_bullet1_statement.
Proof.
  intros M gamma vf pi V W s D HV HW Hf. split; [now apply (value_at_fail M gamma vf pi V)|]. split.
  - apply optimal_iff in HW; auto. now apply HW.
  - unfold target. now rewrite Hf.
Qed.

Theorem Lemma1_bullet2 : Lemma1_bullet2_statement.
Proof.
  intros M next gamma vf pi V W s (D & Det & Hpi & HV & HW) Ds.
  split; [now apply (optimal_le_value M gamma vf W pi V)|]. split.
  - intros n T. split; [now apply (optimal_dead M next Det gamma vf D W HW)|].
    exact (target_time M next Det gamma vf D W HW (S n) s T).
  - intros H B. destruct (proj1 (dead_time M s) Ds) as [n T].
    rewrite (optimal_dead M next Det gamma vf D W HW s n T), (target_time M next Det gamma vf D W HW (S n) s T).
    pose proof (B s (S n) Ds T). destruct D as [G _]. split; apply pow_antitone; auto; Lia.lia.
Qed.

Theorem Lemma1_bullet3 : Lemma1_bullet3_statement.
Proof.
  intros M next gamma vf pi V W s (D & Det & Hpi & HV & HW) Hs. split.
  - apply value_iff in HV; auto. now apply HV.
  - now apply (optimal_safe M next Det gamma vf D W HW).
Qed.

Theorem Positive_value : Positive_value_statement.
Proof.
  intros M next gamma vf pi V W s (D & Det & _ & _ & HW).
  now apply (optimal_positive M next Det gamma vf D W HW).
Qed.

Theorem Theorem2_task : Theorem2_task_statement.
Proof.
  intros M next gamma vf pi V W eps s a (D & Det & Hpi & HV & HW) HS Hs Ha L.
  apply (gate_sound M next Det gamma vf D W HW V eps s a); auto.
  now apply (optimal_le_value M gamma vf W pi V).
Qed.

Theorem Theorem2_recovery : Theorem2_recovery_statement.
Proof.
  intros M next gamma vf pi V W s b (D & Det & _ & _ & HW).
  now apply (recovery_safe M next Det gamma vf D W HW).
Qed.

Theorem Theorem2 : Theorem2_statement.
Proof.
  intros M next gamma vf pi V W eps (D & Det & Hpi & HV & HW) HS.
  split; apply (stays_safe M next Det); intros s a;
    try (intros b Hs _ _; now apply (recovery_safe M next Det gamma vf D W HW)).
  - apply (gate_sound M next Det gamma vf D W HW W eps s a); auto. intro t. Lra.lra.
  - apply (gate_sound M next Det gamma vf D W HW V eps s a); auto.
    now apply (optimal_le_value M gamma vf W pi V).
Qed.

Theorem Exactness : Exactness_statement.
Proof.
  intros M next gamma vf pi V W eps (D & Det & _ & _ & HW) He. split.
  - intros HS s a. now apply (exactness M next Det gamma vf D W HW eps).
  - now apply (exact_threshold M next Det gamma vf D W HW eps).
Qed.

Theorem Tightness : Tightness_statement.
Proof.
  intros M next gamma vf pi V W eps h (D & Det & _ & _ & HW).
  now apply (tightness M next Det gamma vf D W HW).
Qed.

Theorem RRL_refuted : RRL_refuted_statement.
Proof. exact rrl_refuted. Qed.

Theorem RRL_repaired : RRL_repaired_statement.
Proof.
  intros M next gamma vf pi V W eps (D & Det & Hpi & HV & HW) HS Some.
  apply (repaired M next Det gamma vf D W); auto. now apply (optimal_le_value M gamma vf W pi V).
Qed.

Theorem SelfReference : SelfReference_statement.
Proof.
  intros M next gamma vf pi V W eps (D & Det & Hpi & HV & HW) He HS. split.
  - now apply (self_reference_pi M next Det gamma vf D pi V W eps).
  - now apply (self_reference_optimal M next Det gamma vf D pi W eps).
Qed.

Theorem Learned : Learned_statement.
Proof.
  intros M next gamma vf pi V W delta (D & Det & _ & _ & HW) Hd near. split.
  - intros eps Some. split; [|now apply (gate_margin M next Det gamma vf D W HW delta Hd)].
    intros [He HS] q Near. now apply (learned_gate M next Det gamma vf D W HW q delta Near).
  - intros h B. split; [|now apply (recovery_margin M next Det gamma vf D W HW delta Hd)].
    intros L q Near. apply (learned_recovery M next Det gamma vf D W HW q delta Near (gamma ^ h) L).
    apply (threshold_boundary M gamma _ h (proj1 D) B). Lra.lra.
Qed.

Theorem Expectile : Expectile_statement.
Proof.
  intros M gamma vf tau mu W D Ht Hmu HW. split; [now apply expectile_value_exists|].
  intros V HV. pose proof (optimal_le_expectile tau Ht M gamma vf D mu Hmu V W HV HW) as L.
  split; [intros V' HV'; now apply (expectile_value_unique tau Ht M gamma vf D mu Hmu)|].
  split; [exact L|]. split; [intros s a; now apply (Q_le M gamma vf D)|].
  intros next eps Det HS s a. now apply (gate_sound M next Det gamma vf D W HW V eps s a).
Qed.

Theorem Theorem1 : Theorem1_statement.
Proof. exact policy_sets. Qed.

Theorem OneStep : OneStep_statement.
Proof. exact one_step. Qed.

Theorem MinFailure_exists : MinFailure_exists_statement.
Proof.
  intro M. exists (Pmin M). split; [apply Pmin_min|]. intros X' HX'.
  apply (min_failure_unique M); auto. apply Pmin_min.
Qed.

Theorem Qualitative : Qualitative_statement.
Proof. intros M X s HX. split; [now apply zero_avoidable|now apply below_one_escape]. Qed.

Theorem ZeroSet : ZeroSet_statement.
Proof. exact zero_set. Qed.

Theorem Geometric : Geometric_statement.
Proof. exact geometric_bound. Qed.

Theorem Stochastic_refuted : Stochastic_refuted_statement.
Proof. exact stochastic_refuted. Qed.
