(** * The labels of a finite MDP: the graph analysis on its positive-probability successors. *)
From Coq Require Import List Reals Lra Lia.
From DeadEnds Require Import Statements Sums Graph.
Import ListNotations.
Open Scope R_scope.

Section Labels.
Variable M : MDP.

Definition possible (o : R * State M) : bool := if Rlt_dec 0 (fst o) then true else false.
Definition successors s := flat_map (fun a => map snd (filter possible (step M s a))) (actions M s).

Lemma edge_iff : forall s t, edge M s t <-> In t (successors s).
Proof.
  intros s t. unfold successors, edge, succ. rewrite in_flat_map.
  split; intros [a [Ha H]]; exists a; split; auto.
  - destruct H as [p [Hp Hin]]. apply in_map_iff. exists (p, t). split; auto. apply filter_In. split; auto.
    unfold possible. cbn. destruct (Rlt_dec 0 p); auto.
  - apply in_map_iff in H. destruct H as [[p u] [E H]]. apply filter_In in H. destruct H as [Hin Hp].
    cbn in E. subst u. exists p. split; auto. unfold possible in Hp. cbn in Hp.
    destruct (Rlt_dec 0 p); auto. discriminate.
Qed.

Lemma edge_some : forall s, exists t, edge M s t.
Proof.
  intro s. pose proof (actions_some M s) as N. destruct (actions M s) as [|a l] eqn:E; [congruence|].
  destruct (supp_some _ (step_dist M s a)) as [t Ht]. exists t, a. split; auto.
  unfold avail. rewrite E. now left.
Qed.

Lemma successors_some : forall s, In s (states M) -> successors s <> [].
Proof.
  intros s _ E. destruct (edge_some s) as [t Ht]. apply edge_iff in Ht. rewrite E in Ht. exact Ht.
Qed.

Lemma states_closed : forall s t, In s (states M) -> In t (successors s) -> In t (states M).
Proof. intros s t _ _. apply states_all. Qed.

Lemma label_cases : forall s, fail M s = true \/ dead M s \/ safe M s.
Proof.
  intro s. exact (partition _ _ (fail M) _ edge_iff states_closed successors_some s (states_all M s)).
Qed.

Lemma safe_path : forall s, safe M s <->
  exists w, IsPath (edge M) w /\ w 0%nat = s /\ forall k, fail M (w k) = false.
Proof.
  intro s. exact (Graph.safe_path _ _ (fail M) _ edge_iff states_closed successors_some s (states_all M s)).
Qed.

Lemma path_safe : forall w, IsPath (edge M) w -> (forall k, fail M (w k) = false) -> forall k, safe M (w k).
Proof.
  intros w P A k. apply safe_path. exists (fun i => w (k + i)%nat). split; [|split].
  - intro i. rewrite Nat.add_succ_r. apply P.
  - now rewrite Nat.add_0_r.
  - intro i. apply A.
Qed.

Lemma safe_succ : forall s, safe M s -> exists t, edge M s t /\ safe M t.
Proof.
  intros s H. apply safe_path in H. destruct H as [w [P [W0 A]]]. exists (w 1%nat). split.
  - rewrite <- W0. apply P.
  - now apply path_safe.
Qed.

Lemma time_finite : forall s, (exists n, time M s n) <-> ~ safe M s.
Proof.
  intro s. exact (Graph.time_finite _ _ (fail M) _ edge_iff states_closed successors_some s (states_all M s)).
Qed.

Lemma time_zero : forall s, time M s 0 <-> fail M s = true.
Proof.
  intro s. exact (Graph.time_zero _ _ (fail M) _ edge_iff states_closed successors_some s (states_all M s)).
Qed.

Lemma time_succ : forall n s, time M s (S n) <-> fail M s = false /\
  (forall t, edge M s t -> exists k, (k <= n)%nat /\ time M t k) /\ exists t, edge M s t /\ time M t n.
Proof.
  intros n s. exact (Graph.time_succ _ _ (fail M) _ edge_iff states_closed successors_some n s (states_all M s)).
Qed.

Lemma time_fun : forall m n s, time M s m -> time M s n -> m = n.
Proof. intros m n s. apply Graph.time_fun. Qed.

Lemma dead_time : forall s, dead M s <-> exists n, time M s (S n).
Proof.
  intro s. exact (Graph.dead_time _ _ (fail M) _ edge_iff states_closed successors_some s (states_all M s)).
Qed.

Lemma safe_or_time : forall s, safe M s \/ exists n, time M s n.
Proof.
  intro s. destruct (label_cases s) as [F|[D|H]]; auto; right.
  - exists 0%nat. now apply time_zero.
  - apply dead_time in D. destruct D as [n T]. eauto.
Qed.

Lemma safe_no_time : forall s n, safe M s -> time M s n -> False.
Proof. intros s n H T. apply (proj1 (time_finite s)); eauto. Qed.

Lemma safe_alive : forall s, safe M s -> fail M s = false.
Proof. intros s H. apply H. Qed.

Lemma dead_horizon : forall D s, (forall t, dead M t -> In t D) -> dead M s ->
  exists n, (1 <= n <= length D)%nat /\ time M s n.
Proof.
  intros D s. exact (horizon _ _ (fail M) _ edge_iff states_closed successors_some D s (states_all M s)).
Qed.

Lemma dead_no_cycle : forall w i j, IsPath (edge M) w -> (i < j)%nat ->
  (forall k, (i <= k <= j)%nat -> dead M (w k)) -> w i <> w j.
Proof.
  intros w i j. exact (dead_acyclic _ _ (fail M) _ edge_iff states_closed successors_some w i j
    (fun k => states_all M (w k))).
Qed.

Lemma boundary_cases : (exists h, BoundaryHorizon M h) \/ NoUnsafeSuccessor M.
Proof.
  destruct (boundary _ _ (fail M) _ edge_iff states_closed successors_some (states_all M)) as [[h H]|N].
  - left. exists h. exact H.
  - right. intros s t Hs E. destruct (safe_or_time t) as [|[n T]]; auto. exfalso. exact (N s t n Hs E T).
Qed.

Lemma boundary_le : forall H, (forall s n, dead M s -> time M s n -> (n <= H)%nat) ->
  forall t n, time M t n -> (n <= H)%nat.
Proof.
  intros H B t [|n] T; [lia|]. apply (B t); auto. apply dead_time. eauto.
Qed.

(** Failure forced within n+1 steps is forced within n steps after any of them. *)
Lemma forced_step : forall n s t, ForcedWithin (edge M) (fail M) (S n) s -> fail M s = false ->
  edge M s t -> ForcedWithin (edge M) (fail M) n t.
Proof.
  intros n s t F Hf E w P W0.
  destruct (F (fun i => match i with O => s | S j => w j end)) as [[|k] [Hk Fk]]; [|reflexivity|congruence|].
  - apply path_cons; auto. now rewrite W0.
  - exists k. split; auto. lia.
Qed.

Lemma forced_zero : forall s, ForcedWithin (edge M) (fail M) 0 s -> fail M s = true.
Proof.
  intros s F. destruct (label_cases s) as [|[D|H]]; auto.
  - apply dead_time in D. destruct D as [n [_ L]]. apply L in F. lia.
  - apply safe_path in H. destruct H as [w [P [W0 A]]]. destruct (F w P W0) as [k [_ Fk]]. congruence.
Qed.
End Labels.
