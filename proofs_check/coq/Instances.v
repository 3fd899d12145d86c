(** * Each statement on a concrete model, so that none is empty; and false variants, rejected.

    The deterministic statements are instantiated on [five] (RRLCounterexample.v):
    P -> D2 -> D1 -> Fail, P -> Turn, Turn -> Fail, Turn -> Turn; H = H_b = 2. *)
From Coq Require Import List Reals Lra Lia.
From DeadEnds Require Import Statements Sums FixedPoint Values Labels Deterministic RRLCounterexample
  Stochastic StochasticCounterexample CheckerStatements.
From DeadEnds Require Theorems CheckerTheorems.
Import ListNotations.
Open Scope R_scope.

Definition dead_states : list (State five) := [D1; D2].

Lemma five_dead : forall s, dead five s -> In s dead_states.
Proof.
  intros [] [Hf H]; cbn; auto; exfalso.
  - discriminate.
  - apply (proj2 p_safe). split; auto.
  - apply (proj2 turn_safe). split; auto.
Qed.

Lemma half : Discount (1/2) 0.
Proof. split; lra. Qed.

Definition coin : Policy five := fun _ => [(1/2, true); (1/2, false)].
Lemma coin_policy : IsPolicy five coin.
Proof.
  intro s. split; [split; [intros o [<-|[<-|[]]]; cbn; lra|cbn; lra]|]. intros a _. apply five_avail.
Qed.

(** ** Labels *)
Example partition_five : exists w, IsPath (edge five) w /\ w 0%nat = P /\ forall k, fail five (w k) = false.
Proof. exact (proj1 (proj1 (proj2 (Theorems.Partition five P))) p_safe). Qed.
Example horizon_five : exists n, (1 <= n <= 2)%nat /\ time five D2 n.
Proof. exact (Theorems.Horizon five dead_states D2 five_dead d2_dead). Qed.
Example acyclic_five : forall w, IsPath (edge five) w -> w 0%nat = D2 -> w 1%nat = D1 -> w 0%nat <> w 1%nat.
Proof.
  intros w Hw W0 W1. apply (Theorems.Acyclic five w 0%nat 1%nat Hw); [lia|]. intros k Hk.
  assert (E : k = 0%nat \/ k = 1%nat) by lia. destruct E as [->| ->]; [rewrite W0; exact d2_dead|].
  rewrite W1. apply dead_time. exists 0%nat. exact d1_time.
Qed.
Example survival_five : exists t, edge five D2 t /\ time five t 1.
Proof. exact (proj2 (proj2 (proj1 (proj2 (proj2 (Theorems.SurvivalTime five D2)) 1%nat) d2_time))). Qed.
Example memoryless_five : exists n, fail five (Nat.iter n (fun t => move t (task t)) D2) = true.
Proof. exact (proj2 (proj1 (Theorems.MemorylessDead five move five_det D2) d2_dead) task task_policy). Qed.
Example threshold_five : SoundThreshold five (1/2) (1/4).
Proof.
  destruct (Theorems.Threshold five (1/2) (1/4) ltac:(lra)) as [_ [B _]].
  apply (B 2%nat five_boundary). lra.
Qed.

(** ** Values *)
Example value_five : exists V, IsValue five (1/2) 0 coin V.
Proof. destruct (Theorems.Value_exists five (1/2) 0 coin half coin_policy) as [V [H _]]. eauto. Qed.
Example optimal_five : exists W, IsOptimal five (1/2) 0 W.
Proof. destruct (Theorems.Optimal_exists five (1/2) 0 half) as [W [H _]]. eauto. Qed.

Section Five.
Variables V W : State five -> R.
Hypotheses (HV : IsValue five (1/2) 0 coin V) (HW : IsOptimal five (1/2) 0 W).
Let solved : Solved five move (1/2) 0 coin V W := conj half (conj five_det (conj coin_policy (conj HV HW))).

Example bullet1_five : V Fail = 0 /\ W Fail = 0 /\ target five (1/2) V Fail = 1.
Proof. exact (Theorems.Lemma1_bullet1 five _ _ coin V W Fail half HV HW eq_refl). Qed.
Example bullet2_five : (1/2) ^ 1 <= W D2 <= V D2 /\ W D2 = 1/2.
Proof.
  destruct (Theorems.Lemma1_bullet2 five move _ _ coin V W D2 solved d2_dead)
    as [L [E B]]. destruct (E 1%nat d2_time) as [E1 _]. split; [split; [|exact L]|rewrite E1; lra].
  apply (B 2%nat). intros t n Dt T. destruct (Theorems.Horizon five dead_states t five_dead Dt) as [k [Hk Tk]].
  rewrite (time_fun five n k t T Tk). cbn in Hk. lia.
Qed.
Example bullet3_five : 0 <= V P /\ W P = 0.
Proof. exact (Theorems.Lemma1_bullet3 five move _ _ coin V W P solved p_safe). Qed.
Example positive_five : 0 < W D2.
Proof. apply (Theorems.Positive_value five move _ _ coin V W D2 solved). left. exact d2_dead. Qed.
Example task_five : ~ Q five (1/2) V P true < 1/4.
Proof.
  intro L. destruct (Theorems.Theorem2_task five move _ _ coin V W (1/4) P true solved
    threshold_five p_safe (five_avail P true) L) as [_ X]. exact (X d2_dead).
Qed.
Example recovery_five : Argmin five (Q five (1/2) W) P false /\ ~ Argmin five (Q five (1/2) W) P true.
Proof.
  assert (N : ~ Argmin five (Q five (1/2) W) P true).
  { intro A. destruct (Theorems.Theorem2_recovery five move _ _ coin V W P true solved p_safe A) as [_ X].
    exact (X d2_dead). }
  split; auto. pose proof (greedy_argmin five (Q five (1/2) W) P) as G.
  destruct (greedy five (Q five (1/2) W) P); [contradiction|exact G].
Qed.
(** Closed loops exist from P, and stay safe, with either gate. *)
Example closed_loop_five : exists w, ClosedLoop five (Q five (1/2) W) (Q five (1/2) W) (1/4) w /\
  w 0%nat = P /\ forall k, safe five (w k).
Proof.
  destruct (loop_exists five move (Q five (1/2) W) (Q five (1/2) W) (1/4) task P five_det) as [w [W0 [C _]]].
  { intro t. apply five_avail. }
  exists w. split; auto. split; auto. apply (proj1 (Theorems.Theorem2 five move _ _ coin V W (1/4) solved
    threshold_five)); auto. rewrite W0. exact p_safe.
Qed.
Example exact_five : Q five (1/2) W P false < 1/4 /\ ~ Q five (1/2) W P true < 1/4.
Proof.
  pose proof (proj1 (Theorems.Exactness five move _ _ coin V W (1/4) solved ltac:(lra)) threshold_five P) as E.
  split.
  - apply (E false p_safe (five_avail P false)). exact turn_safe.
  - intro L. apply (E true p_safe (five_avail P true)) in L. exact (proj2 L d2_dead).
Qed.
Example tight_five : exists s a, safe five s /\ ~ safe five (move s a) /\ Q five (1/2) W s a < 1/3.
Proof.
  destruct (Theorems.Tightness five move _ _ coin V W (1/3) 2%nat solved five_boundary ltac:(lra))
    as [s [a [Hs [Ha [Hn E]]]]]. exists s, a. split; auto. split; auto. apply Rnot_le_lt. intro L.
  pose proof (E (fun _ b => if b then (if a then 1 else 0) else (if a then 0 else 1)) (negb a)) as X.
  assert (Y : negb a = a); [|destruct a; discriminate]. apply X. right. split; auto.
  split; [apply five_avail|]. intros [] _; destruct a; cbn; lra.
Qed.
Example rrl_five : exists M next tsk s, Deterministic M next /\ length (states M) = 5%nat /\
  IsPolicy M (pure M tsk) /\ safe M s.
Proof. destruct Theorems.RRL_refuted as [_ [M [x [t [s [A [B [C [E _]]]]]]]]]. now exists M, x, t, s. Qed.
Example self_reference_five : PerAction five (safe five) (Q five (1/2) W) (1/4) (pure five (fun _ => false)).
Proof.
  assert (Hp : IsPolicy five (pure five (fun _ => false))) by (apply pure_policy; intro s; apply five_avail).
  destruct (Theorems.Value_exists five (1/2) 0 _ half Hp) as [U [HU _]].
  apply (Theorems.SelfReference five move _ _ _ U W (1/4)
    (conj half (conj five_det (conj Hp (conj HU HW)))) ltac:(lra) threshold_five).
  intros s a Hs Ha. apply supp_dirac in Ha. subst a.
  destruct s; try exact turn_safe; exfalso; [discriminate (proj1 Hs)| |].
  - apply (proj2 Hs), dead_time. exists 0%nat. exact d1_time.
  - exact (proj2 Hs d2_dead).
Qed.
Example learned_five : forall s a, safe five s ->
  (Q five (1/2) W s a + 1/16 < 1/8 <-> safe five (move s a)).
Proof.
  intros s a Hs. destruct (Theorems.Learned five move _ _ coin V W (1/16) solved ltac:(lra)) as [G _].
  refine (proj1 (G (1/8) (ex_intro _ P p_safe)) _ (fun s a => Q five (1/2) W s a + 1/16) _ s a Hs (five_avail s a)).
  - split; [lra|]. intros u t n Hu E T. pose proof (threshold_five u t n Hu E T). lra.
  - intros u b _. rewrite Rabs_pos_eq; lra.
Qed.
(** With error 1/8 = gamma^H_b / 2 some greedy recovery enters a dead-end. *)
Example learned_margin_five : ~ (forall q, (forall s a, avail five s a -> Rabs (q s a - Q five (1/2) W s a) <= 1/8) ->
  forall s b, safe five s -> Argmin five q s b -> safe five (move s b)).
Proof.
  intro H. destruct (Theorems.Learned five move _ _ coin V W (1/8) solved ltac:(lra)) as [_ R].
  apply (R 2%nat five_boundary) in H. lra.
Qed.
Example theorem1_five : forall mu, PerAction five (safe five) (Q five (1/2) V) (1/4) mu ->
  PerAction five (safe five) (Q five (1/2) W) (1/4) mu.
Proof. intro mu. exact (proj1 (Theorems.Theorem1 five _ _ coin V W _ _ mu half coin_policy HV HW)). Qed.
Example one_step_five : prob five (step five P true) (fun t => match t with D2 => true | _ => false end)
  <= Q five (1/2) W P true / (1/2) ^ 2.
Proof.
  apply (Theorems.OneStep five _ 0 W _ 2%nat P true half HW). intros t H.
  destruct t; try discriminate. apply d2_time.
Qed.
End Five.

Example repaired_five : exists W, IsOptimal five (1/2) 0 W /\ StaysSafe five (Q five (1/2) W) (Q five (1/2) W) (1/4).
Proof.
  destruct optimal_five as [W HW]. pose proof (proj2 HW) as [pi [Hpi HV]]. exists W. split; auto.
  apply (Theorems.RRL_repaired five move (1/2) 0 pi W W (1/4)
    (conj half (conj five_det (conj Hpi (conj HV HW)))) threshold_five).
  intros s Hs. destruct (safe_action five move five_det s Hs) as [a [Ha Hn]]. exists a. split; auto.
  rewrite (Q_next five move five_det), (target_safe five move five_det _ _ half W HW _ Hn). lra.
Qed.
Example expectile_five : exists V, IsExpectileValue five (1/2) 0 (3/10) coin V.
Proof.
  destruct optimal_five as [W HW].
  exact (proj1 (Theorems.Expectile five _ _ (3/10) coin W half ltac:(lra) coin_policy HW)).
Qed.

(** ** Stochastic: the gamble with eps = 1/2, p = 1/4 *)
Definition even : 0 < 1/2 < 1 := ltac:(lra).
Example min_failure_gamble : exists X, IsMinFailure (gamble (1/2) even) X.
Proof. destruct (Theorems.MinFailure_exists (gamble (1/2) even)) as [X [H _]]. eauto. Qed.
Example qualitative_gamble : forall X, IsMinFailure (gamble (1/2) even) X -> X Lost = 1 /\ X Ok < 1.
Proof.
  intros X H. rewrite (min_failure_unique (gamble (1/2) even) X _ H (Pmin_min _) Lost).
  split; [apply (X_lost (1/2) even)|].
  apply (proj2 (Theorems.Qualitative (gamble (1/2) even) X Ok H)). apply escape_now.
  apply (proj1 (Theorems.Qualitative (gamble (1/2) even) _ Ok (Pmin_min _))). exact (X_ok (1/2) even).
Qed.
Example zero_set_gamble : forall W, IsOptimal (gamble (1/2) even) (1/2) 0 W -> W Ok = 0.
Proof.
  intros W HW. apply (Theorems.ZeroSet (gamble (1/2) even) (1/2) 0 W 1 half HW); [reflexivity|].
  apply (zero_avoidable (gamble (1/2) even) _ (Pmin_min _)). exact (X_ok (1/2) even).
Qed.
(** The bound is (1 - eps)^n = 1/2^n; the truth is (1 - p)^n = (3/4)^n. *)
Example geometric_gamble : forall n, (1/2) ^ n <= (1 - p (1/2)) ^ n.
Proof.
  intro n. pose (rec := greedy (gamble (1/2) even) (chance (gamble (1/2) even) (X (1/2) even))).
  rewrite <- (gamble_surviving (1/2) even rec n []).
  destruct (Theorems.Geometric (gamble (1/2) even) (X (1/2) even) rec (1/2) (always_risky (1/2) even)
    ltac:(lra)) with (n := n) (s := Ok) as [H _].
  - intro past. apply pure_policy. intro s. apply gamble_avail.
  - right. split; [apply Pmin_min|intro s; apply greedy_argmin].
  - rewrite X_ok in H. replace (1 - 1/2) with (1/2) in H by lra. lra.
Qed.
Example stochastic_refuted_half : exists M X s, IsMinFailure M X /\ X s = 0.
Proof.
  destruct (Theorems.Stochastic_refuted (1/2) even) as [M [X [_ [_ [s [_ [H [_ [_ [E _]]]]]]]]]].
  now exists M, X, s.
Qed.

(** ** The extracted programs, run by the kernel: two states, 0 -> 1, 1 = fail *)
Definition two_rows := [[1]; [0]]%nat.
Example label_two : survival_times two_rows [false; true] = [Some 1; Some 0]%nat.
Proof. reflexivity. Qed.
Example label_two_time : SurvivalTime (table_edge two_rows) (table_fail [false; true]) 0%nat 1%nat.
Proof.
  apply (CheckerTheorems.Labelling two_rows [false; true] 0%nat); [|cbn; lia|reflexivity].
  split; [reflexivity|]. intros [|[|i]] Hi; [| |cbn in Hi; lia];
    (split; [discriminate|intros j [<-|[]]; cbn; lia]).
Qed.
Definition two_check dead_rank := check_certificate 2 (fun i => Nat.eqb i 1) (fun _ => false)
  (fun i => nth i [[[1]]; [[]]] [])%nat (fun i => match i with O => DEAD | _ => FAIL end)
  (fun i => match i with O => dead_rank | _ => O end) (fun _ => O) (fun _ => None).
Example certificate_two : two_check 1 true = true /\ two_check 2 true = false /\ two_check 2 false = true
  /\ two_check 0 true = false /\ two_check 0 false = false.
Proof. repeat split. Qed.
Example certificate_deterministic_two :
  Dead (choice_edge (fun i => Nat.eqb i 1) (fun _ => false) (fun i => nth i [[[1]]; [[]]] [])%nat)
    (fun i => Nat.eqb i 1) 0%nat.
Proof.
  pose proof (CheckerTheorems.Certificate_deterministic 2%nat _ _ _ _ _ _ _ (proj1 certificate_two) 0%nat
    ltac:(lia)) as H. apply H. reflexivity.
Qed.
Example certificate_graph_two : ~ CanEscape
  (choice_avail (fun i => Nat.eqb i 1) (fun _ => false) (fun i => nth i [[[1]]; [[]]] [])%nat)
  choice_succ (fun i => Nat.eqb i 1) 0%nat.
Proof.
  pose proof (CheckerTheorems.Certificate_graph 2%nat _ _ _ _ _ _ _ _ (proj1 certificate_two) 0%nat
    ltac:(lia)) as H. apply H. reflexivity.
Qed.

(** The gamble is described by the graph 0: {0} or {0, 1}; 1 = fail; its label SAFE says X = 0. *)
Definition spot_number (s : State (gamble (1/2) even)) : nat := match s with Ok => 0 | Lost => 1 end.
Lemma gamble_described : Describes (gamble (1/2) even) spot_number 2 (fun i => Nat.eqb i 1) (fun _ => false)
  (fun i => nth i [[[0]; [0; 1]]; [[]]] [])%nat.
Proof.
  intro s. split; [destruct s; cbn; lia|]. split; [destruct s; reflexivity|].
  destruct s; [|discriminate]. intros _.
  assert (Stay : forall j, In j [0%nat] <-> exists t, succ (gamble (1/2) even) Ok false t /\ spot_number t = j).
  { intro j. split.
    - intros [<-|[]]. exists Ok. split; [now apply supp_dirac|reflexivity].
    - intros [t [Ht <-]]. apply supp_dirac in Ht. subst t. now left. }
  assert (Risk : forall j, In j [0; 1]%nat <-> exists t, succ (gamble (1/2) even) Ok true t /\ spot_number t = j).
  { intro j. split.
    - intros [<-|[<-|[]]]; [exists Ok|exists Lost]; (split; [|reflexivity]).
      + exists (1 - p (1/2)). split; [unfold p; lra|right; now left].
      + exists (p (1/2)). split; [unfold p; lra|now left].
    - intros [[] [_ <-]]; cbn; auto. }
  split.
  - intros [] _; [exists [0; 1]%nat|exists [0]%nat]; (split; [cbn; auto|auto]).
  - intros l [<-|[<-|[]]]; [exists false|exists true]; (split; [apply gamble_avail|auto]).
Qed.
Example certificate_probability_gamble : forall X, IsMinFailure (gamble (1/2) even) X -> X Ok = 0.
Proof.
  intros X HX. pose proof (CheckerTheorems.Certificate_probability (gamble (1/2) even) spot_number 2%nat _ _ _
    (fun i => match i with O => SAFE | _ => FAIL end) (fun _ => O) (fun _ => O)
    (fun i => match i with O => Some O | _ => None end) false X gamble_described HX eq_refl Ok) as H.
  apply H. reflexivity.
Qed.

(** ** False variants.  None has the type of the theorem, and each is refuted. *)
Definition Horizon_less_one : Prop := forall M (D : list (State M)), (forall s, dead M s -> In s D) ->
  forall s, dead M s -> exists n, (1 <= n <= length D - 1)%nat /\ time M s n.
Fail Definition wrong : Horizon_less_one := Theorems.Horizon.
Lemma Horizon_less_one_false : ~ Horizon_less_one.
Proof.
  intro H. destruct (H five dead_states five_dead D2 d2_dead) as [n [Hn T]].
  rewrite (time_fun five n 2 D2 T d2_time) in Hn. cbn in Hn. lia.
Qed.

(** eps one power too large *)
Definition Threshold_one_more : Prop := forall M gamma eps h, 0 < gamma < 1 ->
  BoundaryHorizon M (S h) -> eps <= gamma ^ h -> SoundThreshold M gamma eps.
Fail Definition wrong : Threshold_one_more := Theorems.Threshold.
Lemma Threshold_one_more_false : ~ Threshold_one_more.
Proof.
  intro H. assert (G : 0 < 1/2 < 1) by lra.
  pose proof (H five (1/2) (1/2) 1%nat G five_boundary ltac:(lra)) as S.
  apply (threshold_boundary five _ _ 2 G five_boundary) in S. lra.
Qed.

(** Lemma 1, bullet 2 under the loss convention with gamma^(H-1) *)
Definition Lemma1_target_too_large : Prop := forall M next gamma vf W s n,
  Discount gamma vf -> Deterministic M next -> IsOptimal M gamma vf W -> time M s (S n) ->
  gamma ^ n <= target M gamma W s.
Fail Definition wrong : Lemma1_target_too_large := Theorems.Lemma1_bullet2.
Lemma Lemma1_target_too_large_false : ~ Lemma1_target_too_large.
Proof.
  intro H. destruct optimal_five as [W HW].
  pose proof (H five move _ _ W D1 0%nat half five_det HW d1_time) as L.
  rewrite (target_time five move five_det _ _ half W HW 1 D1 d1_time) in L. lra.
Qed.

(** The inclusion of Theorem 1, turned around; and exactness of Q^pi *)
Definition Theorem1_reversed : Prop := forall M gamma vf pi V W eps region mu,
  Discount gamma vf -> IsPolicy M pi -> IsValue M gamma vf pi V -> IsOptimal M gamma vf W ->
  PerAction M region (Q M gamma W) eps mu -> PerAction M region (Q M gamma V) eps mu.
Fail Definition wrong : Theorem1_reversed := Theorems.Theorem1.
Lemma Theorem1_reversed_false : ~ Theorem1_reversed.
Proof.
  intro H. destruct optimal_five as [W HW], value_five as [U HU].
  destruct (Theorems.Value_exists five (1/2) 0 _ half task_policy) as [V [HV _]].
  pose proof (H five _ _ _ V W (1/4) (fun s => s = P) (pure five (fun _ => false)) half task_policy HV HW) as L.
  destruct (critic_p (1/2) 0 V half HV) as [_ E].
  enough (X : Q five (1/2) V P false < 1/4) by (rewrite E in X; lra).
  apply (L ltac:(intros s a -> Ha; apply supp_dirac in Ha; subst a; apply (exact_five U W HU HW))); auto.
  apply supp_dirac. reflexivity.
Qed.

Definition Value_below_optimal : Prop := forall M gamma vf pi V W s, Discount gamma vf ->
  IsPolicy M pi -> IsValue M gamma vf pi V -> IsOptimal M gamma vf W -> V s <= W s.
Fail Definition wrong : Value_below_optimal := Theorems.Optimal_exists.
Lemma Value_below_optimal_false : ~ Value_below_optimal.
Proof.
  intro H. destruct optimal_five as [W HW].
  destruct (Theorems.Value_exists five (1/2) 0 _ half task_policy) as [V [HV _]].
  pose proof (H five _ _ _ V W Turn half task_policy HV HW) as L.
  rewrite (optimal_safe five move five_det _ _ half W HW Turn turn_safe) in L.
  rewrite (task_value (1/2) 0 V half HV Turn eq_refl) in L. unfold target in L. cbn in L. lra.
Qed.

Fail Definition wrong : RRL_claim := Theorems.RRL_repaired.
Lemma RRL_claim_false : ~ RRL_claim.
Proof. exact (proj1 Theorems.RRL_refuted). Qed.

(** Survival of the corrected agent with probability 1 - X, whatever eps *)
Definition Geometric_without_loss : Prop := forall M X rec eps task, 0 <= eps <= 1 ->
  (forall past, IsPolicy M (task past)) -> IsMinFailure M X -> (forall s, Argmin M (chance M X) s (rec s)) ->
  forall n s, 1 - X s <= surviving M X eps rec task n [] s.
Fail Definition wrong : Geometric_without_loss := Theorems.Geometric.
Lemma Geometric_without_loss_false : ~ Geometric_without_loss.
Proof.
  intro H. pose (G := gamble (1/2) even). pose (rec := greedy G (chance G (X (1/2) even))).
  pose proof (H G (X (1/2) even) rec (1/2) (always_risky (1/2) even) ltac:(lra)) as L.
  specialize (L ltac:(intro past; apply pure_policy; intro s; apply gamble_avail) (Pmin_min G)).
  specialize (L ltac:(intro s; apply greedy_argmin) 1%nat Ok). unfold G in L.
  rewrite gamble_surviving, X_ok in L. unfold p in L. lra.
Qed.

(** A checker that ignores ranks: a loop that never fails is not dead. *)
Fail Definition wrong : two_check 0 true = true := eq_refl.
