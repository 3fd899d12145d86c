(** * Deterministic models: Lemma 1, Theorem 2, exactness, tightness, self-reference.

    Everything follows from one fact: under the optimal value W, the loss target of a
    state t, which is the critic of every action that leads to t, is gamma^T(t), and 0
    if t is safe. *)
From Coq Require Import List Reals Lra Lia.
From DeadEnds Require Import Statements Sums FixedPoint Values Labels.
Import ListNotations.
Open Scope R_scope.

Section Order.
Variables (M : MDP) (gamma vf : R).
Hypothesis D : Discount gamma vf.

Lemma optimal_bellman : forall W, IsOptimal M gamma vf W -> Bellman M gamma vf W.
Proof. intros W H. now apply optimal_iff. Qed.

Lemma optimal_le_value : forall W pi V, IsOptimal M gamma vf W -> IsPolicy M pi ->
  IsValue M gamma vf pi V -> forall s, W s <= V s.
Proof. intros W pi V [H _] Hpi HV s. now apply (H pi). Qed.

Lemma value_at_fail : forall pi V s, IsValue M gamma vf pi V -> fail M s = true -> V s = vf.
Proof.
  intros pi V s H Hf. apply (UL_sequence _ _ _ (H s)). apply limit_const with 1%nat.
  intros [|n] Hn; [lia|]. cbn. unfold backup. now rewrite Hf.
Qed.

(** In any model: where failure is forced within n steps, the target is at least gamma^n. *)
Lemma forced_target : forall W, IsOptimal M gamma vf W -> forall n t,
  ForcedWithin (edge M) (fail M) n t -> gamma ^ n <= target M gamma W t.
Proof.
  intros W HW. destruct (optimal_bellman W HW) as [_ [_ B]].
  induction n as [|n IH]; intros t F; unfold target; destruct (fail M t) eqn:Hf.
  - cbn. lra.
  - rewrite (forced_zero M t F) in Hf. discriminate.
  - apply pow_unit. apply D.
  - destruct (B t Hf) as [_ [a [Ha E]]]. cbn. apply Rmult_le_compat_l; [apply Rlt_le, D|].
    rewrite E. apply expect_ge; [apply step_dist|]. intros u Hu. apply IH.
    apply (forced_step M n t u); auto. now exists a.
Qed.
End Order.

Section Deterministic.
Variables (M : MDP) (next : State M -> Action M -> State M).
Hypothesis Det : Deterministic M next.
Variables (gamma vf : R).
Hypothesis D : Discount gamma vf.

Let g1 : 0 < gamma < 1 := proj1 D.

Lemma succ_next : forall s a t, succ M s a t <-> t = next s a.
Proof. intros s a t. unfold succ. rewrite Det. apply supp_dirac. Qed.

Lemma edge_next : forall s t, edge M s t <-> exists a, avail M s a /\ t = next s a.
Proof.
  intros s t. split; intros [a [Ha H]]; exists a; split; auto; now apply succ_next.
Qed.

Lemma next_edge : forall s a, avail M s a -> edge M s (next s a).
Proof. intros s a Ha. apply edge_next. eauto. Qed.

Lemma Q_next : forall V s a, Q M gamma V s a = target M gamma V (next s a).
Proof. intros V s a. unfold Q. rewrite Det. apply expect_dirac. Qed.

Lemma safe_action : forall s, safe M s -> exists a, avail M s a /\ safe M (next s a).
Proof.
  intros s H. destruct (safe_succ M s H) as [t [E Ht]]. apply edge_next in E.
  destruct E as [a [Ha ->]]. eauto.
Qed.

(** ** The optimal value *)
Section Optimal.
Variable W : State M -> R.
Hypothesis HW : IsOptimal M gamma vf W.

Let B : Bellman M gamma vf W := optimal_bellman M gamma vf D W HW.

Lemma optimal_safe : forall s, safe M s -> W s = 0.
Proof.
  intros s Hs. destruct B as [R [_ L]]. apply Rle_antisym; [|apply R].
  apply (discount_vanishes gamma 1); [exact g1|lra|]. intro k. revert s Hs.
  induction k as [|k IH]; intros s Hs.
  - cbn. specialize (R s). lra.
  - destruct (safe_action s Hs) as [a [Ha Hn]].
    destruct (L s (safe_alive M s Hs)) as [Le _]. specialize (Le a Ha).
    rewrite Q_next in Le. unfold target in Le. rewrite (safe_alive M _ Hn) in Le.
    specialize (IH _ Hn). cbn.
    assert (gamma * W (next s a) <= gamma * (1 * gamma ^ k)) by (apply Rmult_le_compat_l; lra). lra.
Qed.

Lemma target_safe : forall s, safe M s -> target M gamma W s = 0.
Proof.
  intros s Hs. unfold target. rewrite (safe_alive M s Hs), (optimal_safe s Hs). lra.
Qed.

Lemma target_time : forall n t, time M t n -> target M gamma W t = gamma ^ n.
Proof.
  intro n. apply (Wf_nat.lt_wf_ind n). clear n. intros n IH t T. destruct n as [|n].
  - apply time_zero in T. unfold target. rewrite T. reflexivity.
  - apply time_succ in T. destruct T as [Hf [A [u [E Tu]]]].
    destruct B as [_ [_ L]]. destruct (L t Hf) as [Le [b [Hb Eb]]].
    unfold target. rewrite Hf. cbn. f_equal. apply Rle_antisym.
    + apply edge_next in E. destruct E as [a [Ha ->]]. rewrite <- (IH n) with (t := next t a); auto.
      rewrite <- Q_next. auto.
    + rewrite Eb, Q_next. destruct (A _ (next_edge t b Hb)) as [k [Hk Tk]].
      rewrite (IH k) with (t := next t b); [|lia|auto]. now apply pow_antitone.
Qed.

Lemma optimal_dead : forall s n, time M s (S n) -> W s = gamma ^ n.
Proof.
  intros s n T. pose proof (target_time _ _ T) as E. unfold target in E.
  assert (Hf : fail M s = false) by now apply time_succ in T. rewrite Hf in E. cbn in E.
  apply Rmult_eq_reg_l in E; lra.
Qed.

Lemma target_pos : forall t, ~ safe M t -> 0 < target M gamma W t.
Proof.
  intros t Ht. apply time_finite in Ht. destruct Ht as [n T]. rewrite (target_time n t T).
  now apply pow_unit.
Qed.

Lemma optimal_positive : forall s, 0 < W s <-> dead M s \/ (fail M s = true /\ 0 < vf).
Proof.
  intro s. destruct (label_cases M s) as [F|[Ds|Hs]].
  - destruct B as [_ [E _]]. rewrite (E s F). split; [auto|]. intros [[X _]|[_ X]]; auto. congruence.
  - split; [auto|]. intros _. apply dead_time in Ds. destruct Ds as [n T].
    rewrite (optimal_dead s n T). now apply pow_unit.
  - rewrite (optimal_safe s Hs). split; [lra|]. intros [X|[X _]].
    + destruct Hs. contradiction.
    + rewrite (safe_alive M s Hs) in X. discriminate.
Qed.

(** ** Gates and recoveries *)
Lemma threshold_target : forall eps s t, SoundThreshold M gamma eps -> safe M s -> edge M s t ->
  target M gamma W t < eps -> safe M t.
Proof.
  intros eps s t He Hs E L. destruct (safe_or_time M t) as [|[n T]]; auto. exfalso.
  rewrite (target_time n t T) in L. specialize (He s t n Hs E T). lra.
Qed.

(** The gate of every critic V >= V* is sound. *)
Lemma gate_sound : forall V eps s a, (forall t, W t <= V t) -> SoundThreshold M gamma eps ->
  safe M s -> avail M s a -> Q M gamma V s a < eps -> safe M (next s a).
Proof.
  intros V eps s a HV He Hs Ha L. apply (threshold_target eps s); auto using next_edge.
  rewrite Q_next in L. pose proof (target_le M gamma vf D W V (next s a) HV). lra.
Qed.

Lemma recovery_safe : forall s b, safe M s -> Argmin M (Q M gamma W) s b -> safe M (next s b).
Proof.
  intros s b Hs [Hb L]. destruct (safe_or_time M (next s b)) as [|[n T]]; auto. exfalso.
  destruct (safe_action s Hs) as [a [Ha Hn]]. specialize (L a Ha). rewrite !Q_next in L.
  rewrite (target_safe _ Hn), (target_time n _ T) in L. pose proof (pow_unit gamma n g1). lra.
Qed.

Lemma exactness : forall eps, 0 < eps -> SoundThreshold M gamma eps -> forall s a, safe M s -> avail M s a ->
  (Q M gamma W s a < eps <-> safe M (next s a)).
Proof.
  intros eps He HS s a Hs Ha. split.
  - apply (gate_sound W eps s a); auto. intro t. lra.
  - intro Hn. rewrite Q_next, target_safe; auto.
Qed.

(** Conversely, only sound thresholds are exact. *)
Lemma exact_threshold : forall eps,
  (forall s a, safe M s -> avail M s a -> (Q M gamma W s a < eps <-> safe M (next s a))) ->
  SoundThreshold M gamma eps.
Proof.
  intros eps H s t n Hs E T. apply Rnot_lt_le. intro L. apply edge_next in E. destruct E as [a [Ha ->]].
  apply (safe_no_time M (next s a) n); auto. apply (H s a Hs Ha). now rewrite Q_next, (target_time n).
Qed.

Lemma tightness : forall eps h, BoundaryHorizon M h -> gamma ^ h < eps ->
  exists s a, safe M s /\ avail M s a /\ ~ safe M (next s a) /\
    forall recovery b, Executes M (Q M gamma W) recovery eps s a b -> b = a.
Proof.
  intros eps h [[s [t [Hs [E T]]]] _] L. apply edge_next in E. destruct E as [a [Ha ->]].
  exists s, a. split; [exact Hs|]. split; [exact Ha|]. split; [intro X; exact (safe_no_time M _ h X T)|].
  intros recovery b [[_ X]|[X _]]; auto. rewrite Q_next, (target_time h _ T) in X. lra.
Qed.

(** ** A learned critic with uniform error [delta] *)
Section Learned.
Variables (q : State M -> Action M -> R) (delta : R).
Hypothesis Near : forall s a, avail M s a -> Rabs (q s a - Q M gamma W s a) <= delta.

Lemma near_bounds : forall s a, avail M s a ->
  Q M gamma W s a - delta <= q s a <= Q M gamma W s a + delta.
Proof.
  intros s a Ha. specialize (Near s a Ha). unfold Rabs in Near. destruct (Rcase_abs _); lra.
Qed.

Lemma learned_gate : forall eps, delta < eps -> SoundThreshold M gamma (eps + delta) ->
  forall s a, safe M s -> avail M s a -> (q s a < eps <-> safe M (next s a)).
Proof.
  intros eps He HS s a Hs Ha. pose proof (near_bounds s a Ha) as N. rewrite Q_next in N. split.
  - intro L. apply (threshold_target (eps + delta) s); auto using next_edge. lra.
  - intro Hn. rewrite (target_safe _ Hn) in N. lra.
Qed.

Lemma learned_recovery : forall e, 2 * delta < e -> SoundThreshold M gamma e ->
  forall s b, safe M s -> Argmin M q s b -> safe M (next s b).
Proof.
  intros e He HS s b Hs [Hb L]. apply (threshold_target e s); auto using next_edge.
  destruct (safe_action s Hs) as [a [Ha Hn]]. specialize (L a Ha).
  pose proof (near_bounds s a Ha) as Na. pose proof (near_bounds s b Hb) as Nb.
  rewrite !Q_next in *. rewrite (target_safe _ Hn) in Na. lra.
Qed.
End Learned.

(** The converse: critics that are off by delta in the worst direction. *)
Section LearnedConverse.
Variable delta : R.
Hypothesis Hd : 0 <= delta.
Let near (q : State M -> Action M -> R) := forall s a, avail M s a -> Rabs (q s a - Q M gamma W s a) <= delta.

Lemma gate_margin : forall eps, (exists s, safe M s) ->
  (forall q, near q -> forall s a, safe M s -> avail M s a -> (q s a < eps <-> safe M (next s a))) ->
  delta < eps /\ SoundThreshold M gamma (eps + delta).
Proof.
  intros eps [s Hs] H. split.
  - destruct (safe_action s Hs) as [a [Ha Hn]].
    assert (N : near (fun s a => Q M gamma W s a + delta)) by (intros u b _; rewrite Rabs_pos_eq; lra).
    apply (proj2 (H _ N s a Hs Ha)) in Hn as L. rewrite Q_next, (target_safe _ Hn) in L. lra.
  - intros u t n Hu E T. apply edge_next in E. destruct E as [a [Ha ->]].
    assert (N : near (fun s a => Q M gamma W s a - delta)) by (intros v b _; rewrite Rabs_left1; lra).
    apply Rnot_lt_le. intro L. apply (safe_no_time M (next u a) n); auto.
    apply (H _ N u a Hu Ha). rewrite Q_next, (target_time n _ T). lra.
Qed.

Definition misled s a := if Req_EM_T (Q M gamma W s a) 0 then delta else Q M gamma W s a - delta.

Lemma misled_near : near misled.
Proof.
  intros s a _. unfold misled. destruct (Req_EM_T (Q M gamma W s a) 0) as [E|_].
  - rewrite E, Rabs_pos_eq; lra.
  - rewrite Rabs_left1; lra.
Qed.

Lemma recovery_margin : forall h, BoundaryHorizon M h ->
  (forall q, near q -> forall s b, safe M s -> Argmin M q s b -> safe M (next s b)) -> 2 * delta < gamma ^ h.
Proof.
  intros h [[s [t [Hs [E T]]]] Max] H. apply Rnot_le_lt. intro L.
  apply edge_next in E. destruct E as [a [Ha ->]].
  apply (safe_no_time M (next s a) h); auto. apply (H misled misled_near s a Hs). split; auto.
  intros b Hb. pose proof (pow_unit gamma h g1) as P. unfold misled. rewrite !Q_next, (target_time h _ T).
  destruct (Req_EM_T (gamma ^ h) 0) as [E|_]; [lra|].
  destruct (safe_or_time M (next s b)) as [Sb|[n Tb]].
  - rewrite (target_safe _ Sb). destruct (Req_EM_T 0 0); lra.
  - rewrite (target_time n _ Tb). pose proof (pow_unit gamma n g1).
    pose proof (pow_antitone gamma n h g1 (Max s _ n Hs (next_edge s b Hb) Tb)).
    destruct (Req_EM_T (gamma ^ n) 0); lra.
Qed.
End LearnedConverse.
End Optimal.

(** ** The closed loop *)
Lemma stays_safe : forall gate recovery eps,
  (forall s a, safe M s -> avail M s a -> gate s a < eps -> safe M (next s a)) ->
  (forall s a b, safe M s -> avail M s a -> eps <= gate s a -> Argmin M recovery s b -> safe M (next s b)) ->
  StaysSafe M gate recovery eps.
Proof.
  intros gate recovery eps G R w C W0 k. induction k as [|k IH]; auto.
  destruct (C k) as [a [b [Ha [[[L ->]|[L Hb]] E]]]]; apply succ_next in E; rewrite E; eauto.
Qed.

Lemma repaired : forall W V eps, IsOptimal M gamma vf W -> (forall t, W t <= V t) ->
  SoundThreshold M gamma eps -> (forall s, safe M s -> exists a, avail M s a /\ Q M gamma V s a < eps) ->
  StaysSafe M (Q M gamma V) (Q M gamma V) eps.
Proof.
  intros W V eps HW HV He Some. apply stays_safe.
  - intros s a. now apply (gate_sound W HW V eps).
  - intros s a b Hs Ha _ [Hb L]. destruct (Some s Hs) as [c [Hc Lc]].
    apply (gate_sound W HW V eps s b); auto. specialize (L c Hc). lra.
Qed.

(** ** Self-reference *)
Section SelfReference.
Variables (pi : Policy M) (V W : State M -> R) (eps : R).
Hypotheses (Hpi : IsPolicy M pi) (HV : IsValue M gamma vf pi V) (HW : IsOptimal M gamma vf W).
Hypotheses (He : 0 < eps) (HS : SoundThreshold M gamma eps).

Let stays := forall s a, safe M s -> Supp (pi s) a -> safe M (next s a).

Lemma stays_value_zero : stays -> forall s, safe M s -> V s = 0.
Proof.
  intros St s Hs. apply value_iff in HV; auto. destruct HV as [R E]. apply Rle_antisym; [|apply R].
  apply (discount_vanishes gamma 1); [exact g1|lra|]. intro k. revert s Hs.
  induction k as [|k IH]; intros s Hs; [cbn; specialize (R s); lra|].
  rewrite E. unfold backup. rewrite (safe_alive M s Hs).
  apply expect_le_const; [apply Hpi|]. intros a Ha. pose proof (St s a Hs Ha) as Hn.
  rewrite Q_next. unfold target. rewrite (safe_alive M _ Hn). specialize (IH _ Hn). cbn.
  assert (gamma * V (next s a) <= gamma * (1 * gamma ^ k)) by (apply Rmult_le_compat_l; lra). lra.
Qed.

Lemma self_reference_pi : PerAction M (safe M) (Q M gamma V) eps pi <-> stays.
Proof.
  split.
  - intros H s a Hs Ha. apply (gate_sound W HW V eps s a); auto.
    + now apply (optimal_le_value M gamma vf W pi).
    + now apply Hpi.
  - intros St s a Hs Ha. pose proof (St s a Hs Ha) as Hn. rewrite Q_next. unfold target.
    rewrite (safe_alive M _ Hn), (stays_value_zero St _ Hn). lra.
Qed.

Lemma self_reference_optimal : PerAction M (safe M) (Q M gamma W) eps pi <-> stays.
Proof.
  split; intros H s a Hs Ha; apply (exactness W HW eps He HS s a Hs (proj2 (Hpi s) a Ha)); now apply H.
Qed.
End SelfReference.

(** ** Dead-ends under memoryless policies *)
Lemma memoryless_dead : forall s, dead M s <-> fail M s = false /\
  forall choose, IsPolicy M (pure M choose) ->
    exists n, fail M (Nat.iter n (fun t => next t (choose t)) s) = true.
Proof.
  intro s. split.
  - intros [Hf Ds]. split; auto. intros choose Hc.
    apply (Ds (fun n => Nat.iter n (fun t => next t (choose t)) s)); [|reflexivity].
    intro i. cbn. apply next_edge, Hc. apply supp_dirac. reflexivity.
  - intros [Hf H]. destruct (label_cases M s) as [F|[Ds|Hs]]; [congruence|auto|]. exfalso.
    set (W := Vstar M gamma vf D).
    assert (HW : IsOptimal M gamma vf W) by apply Vstar_optimal.
    set (rec := greedy M (Q M gamma W)).
    destruct (H rec) as [n Fn]; [apply pure_policy; intro t; apply greedy_argmin|].
    assert (X : safe M (Nat.iter n (fun t => next t (rec t)) s)).
    { clear Fn. induction n as [|n IH]; [exact Hs|]. cbn. apply (recovery_safe W HW); auto. apply greedy_argmin. }
    rewrite (safe_alive M _ X) in Fn. discriminate.
Qed.
End Deterministic.

Lemma threshold_boundary : forall M gamma eps h, 0 < gamma < 1 -> BoundaryHorizon M h ->
  (SoundThreshold M gamma eps <-> eps <= gamma ^ h).
Proof.
  intros M gamma eps h Hg [[s [t [Hs [E T]]]] B]. split.
  - intro H. exact (H s t h Hs E T).
  - intros L s' t' n Hs' E' T'. specialize (B s' t' n Hs' E' T').
    pose proof (pow_antitone gamma n h Hg B). lra.
Qed.

Lemma threshold_free : forall M gamma eps, NoUnsafeSuccessor M -> SoundThreshold M gamma eps.
Proof. intros M gamma eps N s t n Hs E T. exfalso. exact (safe_no_time M t n (N s t Hs E) T). Qed.

Lemma threshold_horizon : forall M gamma eps H, 0 < gamma < 1 ->
  (forall s n, dead M s -> time M s n -> (n <= H)%nat) -> eps <= gamma ^ H ->
  SoundThreshold M gamma eps /\ forall h, BoundaryHorizon M h -> (h <= H)%nat.
Proof.
  intros M gamma eps H Hg B L. pose proof (boundary_le M H B) as Le. split.
  - intros s t n Hs E T. pose proof (pow_antitone gamma n H Hg (Le t n T)). lra.
  - intros h [[s [t [_ [_ T]]]] _]. exact (Le t h T).
Qed.
