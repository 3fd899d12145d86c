(** * Stochastic models: P_min, its graph characterisation, and the episode-level bound. *)
From Coq Require Import List Reals Lra Lia Psatz.
From Coq Require ClassicalDedekindReals.
From DeadEnds Require Import Statements Sums FixedPoint Values Labels Deterministic.
Import ListNotations.
Open Scope R_scope.

Lemma one_step : OneStep_statement.
Proof.
  intros M gamma vf W B H s a D HW HB. assert (P : 0 < gamma ^ H) by (apply pow_lt, D).
  apply Rmult_le_reg_l with (gamma ^ H); auto.
  replace (gamma ^ H * (Q M gamma W s a / gamma ^ H)) with (Q M gamma W s a) by (field; lra).
  unfold prob. rewrite <- expect_scal. apply expect_le; [apply step_dist|]. intros t _.
  destruct (B t) eqn:Bt.
  - pose proof (forced_target M gamma vf D W HW H t (HB t Bt)). lra.
  - apply optimal_iff in HW; auto. destruct HW as [R _].
    pose proof (target_range M gamma vf D W t R). lra.
Qed.

Lemma policy_sets : Theorem1_statement.
Proof.
  intros M gamma vf pi V W eps region mu D Hpi HV HW.
  assert (L : forall s a, Q M gamma W s a <= Q M gamma V s a).
  { intros s a. apply (Q_le M gamma vf D). now apply (optimal_le_value M gamma vf W pi). }
  split.
  - intros H s a Hs Ha. specialize (H s a Hs Ha). specialize (L s a). lra.
  - intros Hmu H s Hs. apply Rle_lt_trans with (2 := H s Hs).
    apply expect_le; [apply Hmu|]. intros a _. apply L.
Qed.

(** ** Where the discounted optimal value is 0 *)
Section ZeroSet.
Variables (M : MDP) (gamma vf : R) (W : State M -> R).
Hypotheses (D : Discount gamma vf) (HW : IsOptimal M gamma vf W).

Let Z := Avoidable (avail M) (succ M) (fail M).
Let B : Bellman M gamma vf W := optimal_bellman M gamma vf D W HW.

Lemma target_nonneg : forall t, 0 <= target M gamma W t.
Proof. intro t. apply (target_range M gamma vf D). apply B. Qed.

Lemma target_zero : forall t, target M gamma W t = 0 <-> fail M t = false /\ W t = 0.
Proof.
  intro t. unfold target. assert (G : 0 < gamma < 1) by apply D. destruct (fail M t).
  - split; [lra|]. intros [X _]. discriminate.
  - split; [|intros [_ ->]; lra]. intro E. split; auto. apply Rmult_integral in E. lra.
Qed.

Lemma zero_value_stays : forall s, fail M s = false -> W s = 0 -> Z s.
Proof.
  intros s Hf E. exists (fun t => fail M t = false /\ W t = 0). split; auto. intros t [Ft Et]. split; auto.
  destruct B as [_ [_ L]]. destruct (L t Ft) as [_ [a [Ha Ea]]]. exists a. split; auto. intros u Hu.
  apply target_zero. apply (expect_zero (step M t a) (target M gamma W)); auto using target_nonneg;
    [apply step_dist|]. unfold Q in Ea. lra.
Qed.

Lemma stays_zero_value : forall s, Z s -> W s = 0.
Proof.
  intros s [S [Ss HS]]. destruct B as [Rg [_ L]]. apply Rle_antisym; [|apply Rg].
  apply (discount_vanishes gamma 1); [apply D|lra|]. intro k. revert s Ss.
  induction k as [|k IH]; intros s Ss; [cbn; specialize (Rg s); lra|].
  destruct (HS s Ss) as [Hf [a [Ha A]]]. apply Rle_trans with (1 := proj1 (L s Hf) a Ha).
  apply expect_le_const; [apply step_dist|]. intros t Ht. unfold target.
  destruct (HS t (A t Ht)) as [Ft _]. rewrite Ft. specialize (IH t (A t Ht)). cbn.
  assert (gamma * W t <= gamma * (1 * gamma ^ k)) by (apply Rmult_le_compat_l; [apply Rlt_le, D|lra]). lra.
Qed.

Lemma zero_critic : forall s a, Q M gamma W s a = 0 <-> forall t, succ M s a t -> Z t.
Proof.
  intros s a. split.
  - intros E t Ht.
    assert (X : target M gamma W t = 0) by
      (apply (expect_zero (step M s a)); auto using target_nonneg; apply step_dist).
    apply target_zero in X. now apply zero_value_stays.
  - intro H. unfold Q. rewrite (expect_ext_supp _ _ (fun _ => 0)); [apply expect_const|..];
      try apply step_dist. intros t Ht. apply target_zero. split; [|now apply stays_zero_value, H].
    destruct (H t Ht) as [S [St HS]]. now apply HS.
Qed.
End ZeroSet.

Theorem zero_set : ZeroSet_statement.
Proof.
  intros M gamma vf W eps D HW Z. split.
  - intros s Hf. split; [now apply (zero_value_stays M gamma vf W D HW)|].
    now apply (stays_zero_value M gamma vf W D HW).
  - intros He Gap s a Zs Ha. pose proof (zero_critic M gamma vf W D HW s a) as C. unfold Z. rewrite <- C.
    destruct (Gap s a Zs Ha); split; lra.
Qed.

Section MinFailure.
Variable M : MDP.

Lemma chance_le : forall X Y s a, (forall t, X t <= Y t) -> chance M X s a <= chance M Y s a.
Proof. intros X Y s a H. apply expect_le; [apply step_dist|]. auto. Qed.

Definition failure_backup X s := if fail M s then 1 else chance M X s (greedy M (chance M X) s).

Lemma failure_backup_le : forall X s a, fail M s = false -> avail M s a ->
  failure_backup X s <= chance M X s a.
Proof. intros X s a Hf Ha. unfold failure_backup. rewrite Hf. now apply greedy_argmin. Qed.

Lemma failure_mono : forall X Y, (forall s, X s <= Y s) -> forall s, failure_backup X s <= failure_backup Y s.
Proof.
  intros X Y H s. destruct (fail M s) eqn:Hf; [unfold failure_backup; rewrite Hf; lra|].
  apply Rle_trans with (1 := failure_backup_le X s _ Hf (proj1 (greedy_argmin M (chance M Y) s))).
  unfold failure_backup. rewrite Hf. now apply chance_le.
Qed.

Lemma failure_zero : forall s, 0 <= failure_backup (fun _ => 0) s.
Proof.
  intro s. unfold failure_backup. destruct (fail M s); [lra|].
  apply expect_ge; [apply step_dist|]. intros t _. lra.
Qed.

Lemma failure_one : forall s, failure_backup (fun _ => 1) s <= 1.
Proof.
  intro s. unfold failure_backup. destruct (fail M s); [lra|].
  apply expect_le_const; [apply step_dist|]. intros t _. lra.
Qed.

Definition Pmin := limit failure_backup failure_mono failure_zero failure_one.
Definition within := iterate failure_backup.

Lemma Pmin_range : forall s, 0 <= Pmin s <= 1.
Proof. intro s. apply limit_range. Qed.

Lemma Pmin_uniform : forall e, 0 < e -> exists n, forall s, Pmin s <= within n s + e.
Proof.
  intros e He.
  assert (A : forall l, exists n, forall s, In s l -> forall m, (m >= n)%nat -> Pmin s <= within m s + e).
  { induction l as [|s l [n IH]]; [exists 0%nat; intros s []|].
    destruct (limit_cv failure_backup failure_mono failure_zero failure_one s e He) as [k Hk].
    exists (max n k). intros t [<-|Ht] m Hm.
    - specialize (Hk m ltac:(lia)). unfold R_dist in Hk. apply Rabs_def2 in Hk.
      fold Pmin in Hk. fold within in Hk. lra.
    - apply IH; auto. lia. }
  destruct (A (states M)) as [n H]. exists n. intro s. apply H; auto. apply states_all.
Qed.

Lemma Pmin_fixed : forall s, failure_backup Pmin s = Pmin s.
Proof.
  intro s. apply Rle_antisym.
  - destruct (fail M s) eqn:Hf.
    + pose proof (limit_above failure_backup failure_mono failure_zero failure_one 1 s) as A.
      cbn in A. unfold failure_backup in *. rewrite Hf in *. exact A.
    + apply Rnot_lt_le. intro L. set (e := (failure_backup Pmin s - Pmin s) / 2).
      destruct (Pmin_uniform e ltac:(unfold e; lra)) as [n Hn].
      set (a := greedy M (chance M (within n)) s).
      assert (E : failure_backup (within n) s = chance M (within n) s a) by (unfold failure_backup; now rewrite Hf).
      assert (B : failure_backup Pmin s <= chance M (within n) s a + e).
      { apply Rle_trans with (1 := failure_backup_le Pmin s a Hf (proj1 (greedy_argmin M _ s))).
        rewrite <- (expect_const (step M s a) e (step_dist M s a)). unfold chance. rewrite <- expect_plus.
        apply expect_le; [apply step_dist|]. auto. }
      pose proof (limit_above failure_backup failure_mono failure_zero failure_one (S n) s) as A.
      cbn in A. fold within in A. fold Pmin in A. unfold e in *. lra.
  - apply (limit_le _ _ _ 1 (limit_cv failure_backup failure_mono failure_zero failure_one s)).
    intros [|n] Hn; [lia|]. cbn. apply failure_mono. intro t. apply limit_above.
Qed.

Lemma within_lower : forall pi, (forall past, IsPolicy M (pi past)) ->
  forall n past s, within n s <= failing M pi n past s.
Proof.
  intros pi Hpi. induction n as [|n IH]; intros past s.
  - cbn. destruct (fail M s); lra.
  - cbn [failing]. unfold within. cbn [iterate]. fold within.
    destruct (fail M s) eqn:Hf; [unfold failure_backup; rewrite Hf; lra|].
    apply expect_ge; [apply Hpi|]. intros a Ha.
    apply Rle_trans with (1 := failure_backup_le _ s a Hf (proj2 (Hpi past s) a Ha)).
    apply expect_le; [apply step_dist|]. intros t _. apply IH.
Qed.

Definition safest := greedy M (chance M Pmin).

Lemma safest_policy : IsPolicy M (pure M safest).
Proof. apply pure_policy. intro s. apply greedy_argmin. Qed.

Lemma safest_upper : forall n past s, failing M (fun _ => pure M safest) n past s <= Pmin s.
Proof.
  induction n as [|n IH]; intros past s; rewrite <- (Pmin_fixed s); cbn [failing];
    unfold failure_backup; destruct (fail M s) eqn:Hf; try lra.
  - apply expect_ge; [apply step_dist|]. intros t _. apply Pmin_range.
  - unfold pure. rewrite expect_dirac. apply chance_le. intro t. apply IH.
Qed.

Lemma Pmin_min : IsMinFailure M Pmin.
Proof.
  split.
  - intros pi Hpi s p H.
    apply (Rle_cv_lim (fun n => within_lower pi Hpi n [] s)); [apply limit_cv|exact H].
  - exists safest. split; [apply safest_policy|]. intros s e He.
    destruct (limit_cv failure_backup failure_mono failure_zero failure_one s e He) as [n Hn].
    exists n. intros k Hk. specialize (Hn k Hk). unfold R_dist in *.
    pose proof (safest_upper k [] s). pose proof (within_lower _ (fun _ => safest_policy) k [] s).
    fold Pmin in Hn. fold within in Hn. apply Rabs_def2 in Hn. apply Rabs_def1; lra.
Qed.

Lemma min_failure_unique : forall X Y, IsMinFailure M X -> IsMinFailure M Y -> forall s, X s = Y s.
Proof.
  intros X Y [LX [cx [Hx Ax]]] [LY [cy [Hy Ay]]] s. apply Rle_antisym.
  - exact (LX _ (fun _ => Hy) s _ (Ay s)).
  - exact (LY _ (fun _ => Hx) s _ (Ax s)).
Qed.

Section Critic.
Variable X : State M -> R.
Hypothesis HX : IsMinFailure M X.

Lemma X_Pmin : forall s, X s = Pmin s.
Proof. apply min_failure_unique; auto. apply Pmin_min. Qed.

Lemma X_range : forall s, 0 <= X s <= 1.
Proof. intro s. rewrite X_Pmin. apply Pmin_range. Qed.

Lemma X_chance : forall s a, chance M X s a = chance M Pmin s a.
Proof. intros s a. apply expect_ext. apply X_Pmin. Qed.

Lemma X_fail : forall s, fail M s = true -> X s = 1.
Proof. intros s Hf. rewrite X_Pmin, <- Pmin_fixed. unfold failure_backup. now rewrite Hf. Qed.

Lemma X_le : forall s a, fail M s = false -> avail M s a -> X s <= chance M X s a.
Proof. intros s a Hf Ha. rewrite X_Pmin, X_chance, <- Pmin_fixed. now apply failure_backup_le. Qed.

Lemma X_attained : forall s, fail M s = false -> exists a, avail M s a /\ X s = chance M X s a.
Proof.
  intros s Hf. exists (safest s). split; [apply greedy_argmin|].
  rewrite X_Pmin, X_chance, <- Pmin_fixed. unfold failure_backup. now rewrite Hf.
Qed.

Lemma argmin_superharmonic : forall rec, (forall s, Argmin M (chance M X) s (rec s)) -> Superharmonic M X rec.
Proof.
  intros rec H. split; [exact X_range|]. split; [exact X_fail|]. intros s Hf.
  destruct (X_attained s Hf) as [a [Ha E]]. rewrite E. now apply H.
Qed.

(** ** P_min = 0 and P_min < 1, by graph analysis *)
Lemma zero_avoidable : forall s, X s = 0 <-> Avoidable (avail M) (succ M) (fail M) s.
Proof.
  intro s. split.
  - intro E. exists (fun t => X t = 0). split; auto. intros t Et.
    destruct (fail M t) eqn:Hf; [rewrite X_fail in Et; auto; lra|]. split; auto.
    destruct (X_attained t Hf) as [a [Ha Ea]]. exists a. split; auto. intros u Hu.
    apply (expect_zero (step M t a) X); auto; [apply step_dist|intro v; apply X_range|].
    unfold chance in Ea. lra.
  - intros [Z [Zs HZ]].
    assert (A : forall n t, Z t -> within n t <= 0).
    { induction n as [|n IH]; intros t Zt; [cbn; lra|]. destruct (HZ t Zt) as [Hf [a [Ha Hu]]].
      apply Rle_trans with (1 := failure_backup_le (within n) t a Hf Ha).
      apply expect_le_const; [apply step_dist|]. intros u Su. apply IH. now apply Hu. }
    apply Rle_antisym; [|apply X_range]. rewrite X_Pmin.
    apply (limit_le _ _ 0 0 (limit_cv failure_backup failure_mono failure_zero failure_one s)).
    intros n _. now apply A.
Qed.

Fixpoint escapes k s : bool :=
  (if Req_EM_T (X s) 0 then true else false) ||
  match k with O => false | S j => negb (fail M s) && existsb (escapes j) (successors M s) end.

Lemma escapes_can : forall k s, escapes k s = true -> CanEscape (avail M) (succ M) (fail M) s.
Proof.
  induction k as [|k IH]; intros s H; cbn in H; destruct (Req_EM_T (X s) 0) as [E|_];
    try (apply escape_now, zero_avoidable, E); cbn in H; [discriminate|].
  apply andb_prop in H. destruct H as [Hf H]. apply existsb_exists in H. destruct H as [t [Ht H]].
  apply edge_iff in Ht. destruct Ht as [a [Ha Hs]]. apply (escape_step _ _ _ s a t); auto.
  now apply Bool.negb_true_iff.
Qed.

Definition never s := forall k, escapes k s = false.

Lemma never_dec : forall s, {k | escapes k s = true} + {never s}.
Proof.
  intro s. destruct (ClassicalDedekindReals.sig_forall_dec (fun k => escapes k s = false)) as [[k H]|H].
  - intro k. destruct (escapes k s); [right; discriminate|now left].
  - left. exists k. now apply Bool.not_false_is_true.
  - now right.
Qed.

Lemma never_succ : forall s a t, never s -> fail M s = false -> avail M s a -> succ M s a t -> never t.
Proof.
  intros s a t H Hf Ha Ht k. destruct (escapes k t) eqn:E; auto. specialize (H (S k)). cbn in H.
  rewrite Hf in H. apply Bool.orb_false_elim in H. destruct H as [_ H]. cbn in H. rewrite <- H. symmetry.
  apply existsb_exists. exists t. split; auto. apply edge_iff. now exists a.
Qed.

Lemma never_one : forall s, never s -> 1 <= X s.
Proof.
  intros s Hs. apply Rnot_lt_le. intro L.
  set (in_never := fun t => if never_dec t then false else true).
  assert (I : forall t, In t (filter in_never (states M)) <-> never t).
  { intro t. rewrite filter_In. unfold in_never. destruct (never_dec t) as [[k E]|N].
    - split; [intros [_ F]; discriminate|]. intro N. rewrite (N k) in E. discriminate.
    - split; auto. intros _. split; auto. apply states_all. }
  destruct (argmin_list X (filter in_never (states M))) as [m [Hm Min]].
  { intro E. apply I in Hs. rewrite E in Hs. exact Hs. }
  apply I in Hm.
  assert (Lm : X m < 1) by (pose proof (Min s (proj2 (I s) Hs)); lra).
  assert (Av : Avoidable (avail M) (succ M) (fail M) m).
  { exists (fun t => never t /\ X t = X m). split; auto. intros t [Nt Et].
    destruct (fail M t) eqn:Hf; [rewrite X_fail in Et; auto; lra|]. split; auto.
    destruct (X_attained t Hf) as [a [Ha Ea]]. exists a. split; auto. intros u Hu.
    assert (Nu : forall v, succ M t a v -> never v) by (intros v Hv; now apply (never_succ t a v)).
    split; [now apply Nu|].
    assert (Z : expect (step M t a) (fun v => if never_dec v then 0 else X v + - X m) = 0).
    { rewrite (expect_ext_supp _ _ (fun v => X v + - X m)).
      - rewrite expect_plus, expect_const by apply step_dist. unfold chance in Ea. lra.
      - apply step_dist.
      - intros v Hv. destruct (never_dec v) as [[k E]|_]; auto. rewrite (Nu v Hv k) in E. discriminate. }
    assert (NN : forall v, 0 <= (if never_dec v then 0 else X v + - X m)).
    { intro v. destruct (never_dec v) as [_|N]; [lra|]. pose proof (Min v (proj2 (I v) N)). lra. }
    pose proof (expect_zero _ _ (step_dist M t a) NN Z u Hu) as EZ.
    cbn in EZ. destruct (never_dec u) as [[k E]|_]; [rewrite (Nu u Hu k) in E; discriminate|lra]. }
  apply zero_avoidable in Av. specialize (Hm 0%nat). cbn in Hm.
  destruct (Req_EM_T (X m) 0); [discriminate|contradiction].
Qed.

Lemma below_one_escape : forall s, X s < 1 <-> CanEscape (avail M) (succ M) (fail M) s.
Proof.
  intro s. split.
  - intro L. destruct (never_dec s) as [[k E]|N]; [now apply (escapes_can k)|].
    pose proof (never_one s N). lra.
  - intro H. induction H as [s Av|s a t Hf Ha Ht _ IH].
    + apply zero_avoidable in Av. lra.
    + apply Rle_lt_trans with (1 := X_le s a Hf Ha).
      apply (expect_strict _ X 1 t); auto; [apply step_dist|]. intro u. apply X_range.
Qed.
End Critic.

(** ** The corrected agent over an episode *)
Section Episode.
Variables (X : State M -> R) (rec : State M -> Action M) (eps : R) (tsk : HistoryPolicy M).
Hypothesis He : 0 <= eps <= 1.
Hypothesis Ht : forall past, IsPolicy M (tsk past).
Hypothesis HS : Superharmonic M X rec.

Lemma corrected_chance : forall s a, fail M s = false ->
  Rmin (1 - X s) (1 - eps) <= 1 - chance M X s (corrected M X eps rec s a).
Proof.
  intros s a Hf. pose proof (Rmin_l (1 - X s) (1 - eps)). pose proof (Rmin_r (1 - X s) (1 - eps)).
  unfold corrected. destruct (Rlt_dec (chance M X s a) eps) as [L|_]; [lra|].
  destruct HS as [_ [_ Sh]]. specialize (Sh s Hf). lra.
Qed.

Lemma min_product : forall s, (1 - X s) * (1 - eps) <= Rmin (1 - X s) (1 - eps).
Proof.
  intro s. destruct HS as [R _]. specialize (R s). apply Rmin_glb; nra.
Qed.

Lemma episode_step : forall n, (forall past s, (1 - X s) * (1 - eps) ^ n <= surviving M X eps rec tsk n past s) ->
  forall past s, fail M s = false ->
  (1 - eps) ^ n * Rmin (1 - X s) (1 - eps) <= surviving M X eps rec tsk (S n) past s.
Proof.
  intros n IH past s Hf. cbn [surviving]. rewrite Hf. apply expect_ge; [apply Ht|]. intros a _.
  set (b := corrected M X eps rec s a). assert (P : 0 <= (1 - eps) ^ n) by (apply pow_le; lra).
  pose proof (step_dist M s b) as DS.
  apply Rle_trans with ((1 - eps) ^ n * (1 - chance M X s b)).
  - apply Rmult_le_compat_l; auto. now apply corrected_chance.
  - replace ((1 - eps) ^ n * (1 - chance M X s b))
      with (expect (step M s b) (fun t => (1 - eps) ^ n + - (1 - eps) ^ n * X t)).
    + apply expect_le; auto. intros t _. specialize (IH (s :: past) t). lra.
    + rewrite expect_plus, expect_const, expect_scal by auto. unfold chance. ring.
Qed.

Lemma geometric : forall n past s, (1 - X s) * (1 - eps) ^ n <= surviving M X eps rec tsk n past s.
Proof.
  induction n as [|n IH]; intros past s; destruct (fail M s) eqn:Hf;
    try (destruct HS as [R [F _]]; cbn; rewrite Hf; specialize (R s); try rewrite (F s Hf); lra).
  apply Rle_trans with (2 := episode_step n IH past s Hf).
  pose proof (min_product s). assert (0 <= (1 - eps) ^ n) by (apply pow_le; lra).
  replace ((1 - X s) * (1 - eps) ^ S n) with ((1 - eps) ^ n * ((1 - X s) * (1 - eps))) by (cbn; ring).
  now apply Rmult_le_compat_l.
Qed.
End Episode.
End MinFailure.

Theorem geometric_bound : Geometric_statement.
Proof.
  intros M X rec eps tsk He Ht H n s.
  assert (HS : Superharmonic M X rec) by (destruct H as [|[HX HA]]; auto; now apply argmin_superharmonic).
  split; [now apply geometric|]. intro Hf. apply episode_step; auto. now apply geometric.
Qed.
