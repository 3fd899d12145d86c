(** * Values as limits: monotone iterates from 0, and the discounted fixed point.

    [F] is a Bellman operator: monotone, and it maps functions with values in
    [0,1] to such functions.  Its iterates from 0 grow and converge.  If [F] also
    shrinks constants by [g] < 1, the limit is its only fixed point in [0,1], above
    every bounded f <= F f and below every nonnegative f >= F f. *)
From Coq Require Import List Reals Lra Lia.
From DeadEnds Require Import Statements Sums.
Open Scope R_scope.

Lemma limit_le : forall u L c N, Un_cv u L -> (forall n, (n >= N)%nat -> u n <= c) -> L <= c.
Proof.
  intros u L c N H B. destruct (Rle_lt_dec L c) as [|P]; auto. exfalso.
  destruct (H (L - c) ltac:(lra)) as [m Hm].
  specialize (Hm (max m N) ltac:(lia)). specialize (B (max m N) ltac:(lia)).
  unfold R_dist in Hm. apply Rabs_def2 in Hm. lra.
Qed.

Lemma limit_ge : forall u L c N, Un_cv u L -> (forall n, (n >= N)%nat -> c <= u n) -> c <= L.
Proof.
  intros u L c N H B. destruct (Rle_lt_dec c L) as [|P]; auto. exfalso.
  destruct (H (c - L) ltac:(lra)) as [m Hm].
  specialize (Hm (max m N) ltac:(lia)). specialize (B (max m N) ltac:(lia)).
  unfold R_dist in Hm. apply Rabs_def2 in Hm. lra.
Qed.

Lemma limit_ext : forall u v L, (forall n, u n = v n) -> Un_cv u L -> Un_cv v L.
Proof. intros u v L E H e He. destruct (H e He) as [N A]. exists N. intros n Hn. rewrite <- E. auto. Qed.

Lemma limit_const : forall u c N, (forall n, (n >= N)%nat -> u n = c) -> Un_cv u c.
Proof.
  intros u c N H e He. exists N. intros n Hn. rewrite H by auto. unfold R_dist.
  replace (c - c) with 0 by lra. rewrite Rabs_R0. lra.
Qed.

Section Iteration.
Context {St : Type} (F : (St -> R) -> St -> R).
Hypothesis mono : forall f h, (forall s, f s <= h s) -> forall s, F f s <= F h s.
Hypothesis zero : forall s, 0 <= F (fun _ => 0) s.
Hypothesis one : forall s, F (fun _ => 1) s <= 1.

Fixpoint iterate n : St -> R := match n with O => fun _ => 0 | S m => F (iterate m) end.

Lemma iterate_range : forall n s, 0 <= iterate n s <= 1.
Proof.
  induction n as [|n IH]; intro s; cbn; [lra|]. split.
  - apply Rle_trans with (1 := zero s). apply mono. intro t. apply IH.
  - apply Rle_trans with (2 := one s). apply mono. intro t. apply IH.
Qed.

Lemma iterate_grows : forall n s, iterate n s <= iterate (S n) s.
Proof. induction n as [|n IH]; intro s; [apply zero|]. cbn. apply mono, IH. Qed.

Lemma limit_sig : forall s, {l | Un_cv (fun n => iterate n s) l}.
Proof.
  intro s. apply growing_cv.
  - intro n. apply iterate_grows.
  - exists 1. intros x [n ->]. apply iterate_range.
Qed.

Definition limit s := proj1_sig (limit_sig s).

Lemma limit_cv : forall s, Un_cv (fun n => iterate n s) (limit s).
Proof. intro s. unfold limit. destruct (limit_sig s). auto. Qed.

Lemma limit_above : forall n s, iterate n s <= limit s.
Proof. intros n s. apply (growing_ineq (fun k => iterate k s)); [intro k; apply iterate_grows|apply limit_cv]. Qed.

Lemma limit_range : forall s, 0 <= limit s <= 1.
Proof.
  intro s. split; [apply (limit_above 0)|].
  apply (limit_le _ _ 1 0 (limit_cv s)). intros n _. apply iterate_range.
Qed.

Lemma limit_least : forall f, (forall s, 0 <= f s) -> (forall s, F f s <= f s) -> forall s, limit s <= f s.
Proof.
  intros f f0 Ff s.
  assert (A : forall n t, iterate n t <= f t).
  { induction n as [|n IH]; intro t; [apply f0|]. cbn. apply Rle_trans with (2 := Ff t). now apply mono. }
  apply (limit_le _ _ (f s) 0 (limit_cv s)). intros n _. apply A.
Qed.

(** A fixed point is inherited from uniform convergence. *)
Variable g : R.
Hypothesis g1 : 0 < g < 1.
Hypothesis shift : forall f c s, 0 <= c -> F (fun t => f t + c) s <= F f s + g * c.

Lemma iterate_gap : forall m n s, iterate (n + m) s <= iterate n s + g ^ n.
Proof.
  intro m. induction n as [|n IH]; intro s.
  - cbn. pose proof (iterate_range m s). lra.
  - cbn [iterate Nat.add pow]. pose proof (pow_unit g n g1).
    apply Rle_trans with (2 := shift (iterate n) (g ^ n) s ltac:(lra)). apply mono. intro t. apply IH.
Qed.

Lemma limit_near : forall n s, limit s <= iterate n s + g ^ n.
Proof.
  intros n s. apply (limit_le _ _ _ n (limit_cv s)). intros k Hk.
  replace k with (n + (k - n))%nat by lia. apply iterate_gap.
Qed.

Lemma limit_fixed : forall s, F limit s = limit s.
Proof.
  intro s. apply Rle_antisym.
  - cut (F limit s - limit s <= 0); [lra|]. apply (discount_vanishes g 1); [auto|lra|]. intro n.
    assert (A : F limit s <= F (iterate n) s + g * g ^ n).
    { pose proof (pow_unit g n g1). apply Rle_trans with (2 := shift (iterate n) (g ^ n) s ltac:(lra)).
      apply mono. intro t. apply limit_near. }
    pose proof (limit_above (S n) s) as B. cbn in B. pose proof (pow_unit g n g1). nra.
  - apply (limit_le _ _ _ 1 (limit_cv s)). intros [|n] Hn; [lia|]. cbn. apply mono. intro t. apply limit_above.
Qed.

Lemma limit_greatest : forall f C, 0 <= C -> (forall s, f s <= C) -> (forall s, f s <= F f s) ->
  forall s, f s <= limit s.
Proof.
  intros f C C0 fC Ff s. cut (f s - limit s <= 0); [lra|]. apply (discount_vanishes g C); auto.
  intro k. revert s.
  assert (A : forall n t, f t <= limit t + C * g ^ n).
  { induction n as [|n IH]; intro t.
    - cbn. pose proof (limit_range t). specialize (fC t). lra.
    - apply Rle_trans with (1 := Ff t). rewrite <- limit_fixed. pose proof (pow_unit g n g1).
      replace (C * g ^ S n) with (g * (C * g ^ n)) by (cbn; ring).
      apply Rle_trans with (2 := shift limit (C * g ^ n) t ltac:(nra)). now apply mono. }
  intro s. specialize (A k s). lra.
Qed.

Theorem limit_unique : forall V, (forall s, Un_cv (fun n => iterate n s) (V s)) <->
  (forall s, 0 <= V s <= 1) /\ forall s, V s = F V s.
Proof.
  intro V. split.
  - intro H. assert (E : forall s, V s = limit s).
    { intro s. exact (UL_sequence _ _ _ (H s) (limit_cv s)). }
    split; [intro s; rewrite E; apply limit_range|]. intro s. rewrite E, <- limit_fixed.
    apply Rle_antisym; apply mono; intro t; rewrite E; lra.
  - intros [B E] s. replace (V s) with (limit s); [apply limit_cv|]. apply Rle_antisym.
    + apply limit_least; [intro t; apply B|]. intro t. rewrite <- E. lra.
    + apply (limit_greatest V 1); [lra| |]; intro t; [apply B|]. rewrite <- E. lra.
Qed.
End Iteration.
