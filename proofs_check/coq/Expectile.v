(** * The expectile critic: what the paper trains lies above V*.

    The minimiser of the expectile loss is the root of its derivative, which is
    continuous and strictly decreasing; so it exists, is monotone and moves with a
    constant.  The backup is then a Bellman operator like the others. *)
From Coq Require Import List Reals Lra Lia Psatz.
From DeadEnds Require Import Statements Sums FixedPoint Values.
Import ListNotations.
Open Scope R_scope.

Section Expectile.
Variable tau : R.
Hypothesis Htau : 0 < tau < 1.

Definition slope u := (if Rlt_dec u 0 then 1 - tau else tau) * u.
Definition kappa := Rmin tau (1 - tau).

Lemma kappa_pos : 0 < kappa.
Proof. unfold kappa. apply Rmin_glb_lt; lra. Qed.

Lemma slope_grows : forall u v, u <= v -> kappa * (v - u) <= slope v - slope u <= v - u.
Proof.
  intros u v H. unfold slope, kappa. pose proof (Rmin_l tau (1 - tau)). pose proof (Rmin_r tau (1 - tau)).
  set (k := Rmin tau (1 - tau)) in *. destruct (Rlt_dec u 0), (Rlt_dec v 0); split; nra.
Qed.

Section Root.
Context {A : Type}.
Implicit Types (d : Dist A) (f h : A -> R).

Definition pull d f m := expect d (fun a => slope (f a - m)).

Lemma pull_decreases : forall d f m n, IsDist d -> m <= n ->
  kappa * (n - m) <= pull d f m - pull d f n <= n - m.
Proof.
  intros d f m n D H.
  assert (E : pull d f m - pull d f n = expect d (fun a => slope (f a - m) + -1 * slope (f a - n))).
  { rewrite expect_plus, expect_scal. unfold pull. lra. }
  rewrite E. split.
  - apply expect_ge; auto. intros a _. pose proof (slope_grows (f a - n) (f a - m)). lra.
  - apply expect_le_const; auto. intros a _. pose proof (slope_grows (f a - n) (f a - m)). lra.
Qed.

Lemma pull_continuous : forall d f, IsDist d -> continuity (pull d f).
Proof.
  intros d f D x e He. exists e. split; [exact He|]. intros y [_ Hy]. cbn in *. unfold R_dist in *.
  apply Rle_lt_trans with (2 := Hy). pose proof kappa_pos.
  destruct (Rle_lt_dec x y) as [L|L].
  - pose proof (pull_decreases d f x y D L). rewrite Rabs_left1 by nra. rewrite Rabs_pos_eq; lra.
  - pose proof (pull_decreases d f y x D ltac:(lra)). rewrite Rabs_pos_eq by nra. rewrite Rabs_left1; lra.
Qed.

Lemma pull_above : forall d f c, IsDist d -> (forall a, Supp d a -> c <= f a) -> 0 <= pull d f c.
Proof.
  intros d f c D H. apply expect_ge; auto. intros a Ha. specialize (H a Ha). unfold slope.
  destruct (Rlt_dec _ 0); nra.
Qed.

Lemma pull_below : forall d f c, IsDist d -> (forall a, Supp d a -> f a <= c) -> pull d f c <= 0.
Proof.
  intros d f c D H. apply expect_le_const; auto. intros a Ha. specialize (H a Ha). unfold slope.
  destruct (Rlt_dec _ 0); nra.
Qed.

Lemma expectile_sig : forall d f, IsDist d -> {m | pull d f m = 0}.
Proof.
  intros d f D.
  assert (N : map snd d <> []).
  { destruct d as [|o d]; [|discriminate]. destruct D as [_ T]. cbn in T. lra. }
  assert (I : forall a, Supp d a -> In a (map snd d)).
  { intros a [p [_ H]]. apply in_map_iff. exists (p, a). auto. }
  destruct (argmin_list f _ N) as [lo [_ Lo]].
  destruct (argmin_list (fun a => - f a) _ N) as [hi [Hin Hi]].
  assert (Up : forall a, Supp d a -> f a <= f hi) by (intros a Ha; specialize (Hi a (I a Ha)); cbn in Hi; lra).
  destruct (IVT_cor (pull d f) (f lo) (f hi)) as [m [_ Hm]].
  - now apply pull_continuous.
  - now apply Lo.
  - assert (0 <= pull d f (f lo)) by (apply pull_above; auto).
    assert (pull d f (f hi) <= 0) by (apply pull_below; auto). nra.
  - now exists m.
Qed.

Lemma root_le : forall d f h c m n, IsDist d -> (forall a, f a <= h a + c) ->
  pull d f m = 0 -> pull d h n = 0 -> m <= n + c.
Proof.
  intros d f h c m n D H Em En. destruct (Rle_lt_dec m (n + c)) as [|L]; auto. exfalso.
  pose proof (pull_decreases d f (n + c) m D ltac:(lra)) as P.
  assert (B : pull d f (n + c) <= pull d h n).
  { apply expect_le; auto. intros a _. specialize (H a).
    assert (X : f a - (n + c) <= h a - n) by lra.
    pose proof (slope_grows _ _ X) as G. pose proof kappa_pos. nra. }
  pose proof kappa_pos. nra.
Qed.

Lemma root_ge : forall d f c m, IsDist d -> (forall a, Supp d a -> c <= f a) -> pull d f m = 0 -> c <= m.
Proof.
  intros d f c m D H E. destruct (Rle_lt_dec c m) as [|L]; auto. exfalso.
  pose proof (pull_decreases d f m c D ltac:(lra)). pose proof (pull_above d f c D H).
  pose proof kappa_pos. nra.
Qed.

Lemma root_upper : forall d f c m, IsDist d -> (forall a, Supp d a -> f a <= c) -> pull d f m = 0 -> m <= c.
Proof.
  intros d f c m D H E. destruct (Rle_lt_dec m c) as [|L]; auto. exfalso.
  pose proof (pull_decreases d f c m D ltac:(lra)). pose proof (pull_below d f c D H).
  pose proof kappa_pos. nra.
Qed.
End Root.

Lemma loss_convex : forall u v,
  expectile_loss tau u + -2 * ((u - v) * slope u) + kappa * ((u - v) * (u - v)) <= expectile_loss tau v.
Proof.
  intros u v. unfold expectile_loss, slope, kappa.
  pose proof (Rmin_l tau (1 - tau)) as K1. pose proof (Rmin_r tau (1 - tau)) as K2.
  set (k := Rmin tau (1 - tau)) in *.
  assert (S : forall w, k <= w -> 0 <= (w - k) * ((u - v) * (u - v)))
    by (intros w Hw; apply Rmult_le_pos; [lra|apply Rle_0_sqr]).
  assert (O : forall w z, k <= w -> k <= z -> u * v <= 0 ->
    0 <= (w - k) * (u * u) + (z - k) * (v * v) + -2 * ((w - k) * (u * v))).
  { intros w z Hw Hz Huv. pose proof (Rle_0_sqr u) as U. pose proof (Rle_0_sqr v) as V. unfold Rsqr in *.
    assert (0 <= (w - k) * (u * u)) by (apply Rmult_le_pos; lra).
    assert (0 <= (z - k) * (v * v)) by (apply Rmult_le_pos; lra).
    assert (0 <= (w - k) * - (u * v)) by (apply Rmult_le_pos; lra). lra. }
  destruct (Rlt_dec u 0), (Rlt_dec v 0).
  - specialize (S (1 - tau)). lra.
  - specialize (O (1 - tau) tau). assert (u * v <= 0) by nra. lra.
  - specialize (O tau (1 - tau)). assert (u * v <= 0) by nra. lra.
  - specialize (S tau). lra.
Qed.

Variables (M : MDP) (gamma vf : R).
Hypothesis D : Discount gamma vf.
Variable mu : Policy M.
Hypothesis Hmu : IsPolicy M mu.

Let g1 : 0 < gamma < 1 := proj1 D.

Lemma root_below : forall s f m x, pull (mu s) f m = 0 ->
  expect (mu s) (fun a => expectile_loss tau (f a - m)) + kappa * ((x - m) * (x - m)) <=
  expect (mu s) (fun a => expectile_loss tau (f a - x)).
Proof.
  intros s f m x E. destruct (Hmu s) as [DM _].
  apply Rle_trans with (expect (mu s) (fun a => (expectile_loss tau (f a - m)
    + (-2 * (x - m)) * slope (f a - m)) + kappa * ((x - m) * (x - m)))).
  - rewrite !expect_plus, expect_scal, expect_const by auto. unfold pull in E. rewrite E. lra.
  - apply expect_le; auto. intros a _. pose proof (loss_convex (f a - m) (f a - x)) as C.
    replace (f a - m - (f a - x)) with (x - m) in C by ring. lra.
Qed.

Lemma root_minimises : forall s f m, pull (mu s) f m = 0 -> IsExpectile M tau (mu s) f m.
Proof.
  intros s f m E x. pose proof (root_below s f m x E) as L. pose proof kappa_pos.
  assert (0 <= kappa * ((x - m) * (x - m))) by (apply Rmult_le_pos; [lra|apply Rle_0_sqr]). lra.
Qed.

Lemma minimiser_unique : forall s f m x, pull (mu s) f m = 0 -> IsExpectile M tau (mu s) f x -> x = m.
Proof.
  intros s f m x E H. pose proof (root_below s f m x E) as L. specialize (H m). pose proof kappa_pos.
  apply Rminus_diag_uniq, Rsqr_0_uniq. apply Rle_antisym; [|apply Rle_0_sqr]. unfold Rsqr.
  apply Rmult_le_reg_l with kappa; lra.
Qed.

(** A minimiser of the expectile loss is at least the least value on the data. *)
Lemma minimiser_ge : forall s f m c, IsExpectile M tau (mu s) f m ->
  (forall a, Supp (mu s) a -> c <= f a) -> c <= m.
Proof.
  intros s f m c H L. destruct (Rle_lt_dec c m) as [|Lt]; auto. exfalso.
  destruct (Hmu s) as [DM _]. specialize (H c).
  assert (G : expect (mu s) (fun a => expectile_loss tau (f a - c) + tau * ((c - m) * (c - m))) <=
              expect (mu s) (fun a => expectile_loss tau (f a - m))).
  { apply expect_le; auto. intros a Ha. specialize (L a Ha). unfold expectile_loss.
    destruct (Rlt_dec (f a - c) 0), (Rlt_dec (f a - m) 0); try lra.
    assert (0 <= (f a - c) * (c - m)) by (apply Rmult_le_pos; lra).
    rewrite <- Rmult_plus_distr_l. apply Rmult_le_compat_l; [lra|]. nra. }
  rewrite expect_plus, (expect_const (mu s)) in G by auto.
  assert (0 < tau * ((c - m) * (c - m))) by (repeat apply Rmult_lt_0_compat; lra). lra.
Qed.

(** ** Existence *)
Definition expectile s f : R := proj1_sig (expectile_sig (mu s) f (proj1 (Hmu s))).

Lemma expectile_root : forall s f, pull (mu s) f (expectile s f) = 0.
Proof. intros s f. unfold expectile. destruct (expectile_sig _ f _). auto. Qed.

Definition expectile_backup V s := if fail M s then vf else expectile s (Q M gamma V s).

Lemma expectile_mono : forall V W, (forall s, V s <= W s) ->
  forall s, expectile_backup V s <= expectile_backup W s.
Proof.
  intros V W H s. unfold expectile_backup. destruct (fail M s); [lra|].
  rewrite <- (Rplus_0_r (expectile s (Q M gamma W s))).
  apply (root_le (mu s) (Q M gamma V s) (Q M gamma W s)); try apply expectile_root; [apply Hmu|].
  intro a. rewrite Rplus_0_r. now apply (Q_le M gamma vf D).
Qed.

Lemma expectile_shift : forall V c s, 0 <= c ->
  expectile_backup (fun t => V t + c) s <= expectile_backup V s + gamma * c.
Proof.
  intros V c s H. assert (0 <= gamma * c) by (apply Rmult_le_pos; lra).
  unfold expectile_backup. destruct (fail M s); [lra|].
  apply (root_le (mu s) (Q M gamma (fun t => V t + c) s) (Q M gamma V s)); try apply expectile_root; [apply Hmu|].
  intro a. now apply (Q_shift M gamma vf D).
Qed.

Lemma expectile_zero : forall s, 0 <= expectile_backup (fun _ => 0) s.
Proof.
  intro s. unfold expectile_backup. destruct (fail M s); [apply D|].
  apply (root_ge (mu s) (Q M gamma (fun _ => 0) s)); [apply Hmu| |apply expectile_root].
  intros a _. apply (Q_range M gamma vf D). intro t. lra.
Qed.

Lemma expectile_one : forall s, expectile_backup (fun _ => 1) s <= 1.
Proof.
  intro s. unfold expectile_backup. destruct (fail M s); [apply D|].
  apply (root_upper (mu s) (Q M gamma (fun _ => 1) s)); [apply Hmu| |apply expectile_root].
  intros a _. apply (Q_range M gamma vf D). intro t. lra.
Qed.

Lemma expectile_value_exists : exists V, IsExpectileValue M gamma vf tau mu V.
Proof.
  set (V := limit expectile_backup expectile_mono expectile_zero expectile_one). exists V. intro s.
  pose proof (limit_fixed _ expectile_mono expectile_zero expectile_one gamma g1 expectile_shift s) as E.
  fold V in E. unfold expectile_backup in E. destruct (fail M s); [now symmetry|].
  rewrite <- E. apply root_minimises, expectile_root.
Qed.

(** ** Soundness *)
Lemma optimal_le_expectile : forall V W, IsExpectileValue M gamma vf tau mu V ->
  IsOptimal M gamma vf W -> forall s, W s <= V s.
Proof.
  intros V W HV HW. apply optimal_iff in HW; auto. destruct HW as [R [F L]].
  destruct (bounded_list (fun s => W s - V s) (states M)) as [C [C0 B]].
  assert (A : forall k s, W s <= V s + C * gamma ^ k).
  { induction k as [|k IH]; intro s.
    - specialize (B s (states_all M s)). cbn in *. lra.
    - specialize (HV s). pose proof (pow_unit gamma (S k) g1). pose proof (pow_unit gamma k g1).
      destruct (fail M s) eqn:Hf; [rewrite HV, (F s Hf); nra|].
      cut (W s - C * gamma ^ S k <= V s); [lra|].
      apply (minimiser_ge s (Q M gamma V s)); auto. intros a Ha.
      destruct (L s Hf) as [Le _]. specialize (Le a (proj2 (Hmu s) a Ha)).
      pose proof (Q_le M gamma vf D W (fun t => V t + C * gamma ^ k) s a IH) as Q1.
      pose proof (Q_shift M gamma vf D V (C * gamma ^ k) s a ltac:(nra)) as Q2.
      replace (C * gamma ^ S k) with (gamma * (C * gamma ^ k)) by (cbn; ring). lra. }
  intro s. cut (W s - V s <= 0); [lra|]. apply (discount_vanishes gamma C); auto.
  intro k. specialize (A k s). lra.
Qed.

Lemma expectile_value_unique : forall V V', IsExpectileValue M gamma vf tau mu V ->
  IsExpectileValue M gamma vf tau mu V' -> forall s, V s = V' s.
Proof.
  assert (U : forall V, IsExpectileValue M gamma vf tau mu V -> forall s,
    V s = limit expectile_backup expectile_mono expectile_zero expectile_one s).
  { intros V HV.
    assert (F : forall s, V s = expectile_backup V s).
    { intro s. specialize (HV s). unfold expectile_backup. destruct (fail M s); auto.
      apply (minimiser_unique s (Q M gamma V s)); auto. apply expectile_root. }
    intro s. apply Rle_antisym.
    - destruct (bounded_list V (states M)) as [C [C0 B]].
      apply (limit_greatest _ expectile_mono expectile_zero expectile_one gamma g1 expectile_shift V C C0).
      + intro t. apply B, states_all.
      + intro t. rewrite <- (F t). lra.
    - apply limit_least; [|intro t; rewrite <- (F t); lra].
      intro t. pose proof (Vstar_range M gamma vf D t).
      pose proof (optimal_le_expectile V _ HV (Vstar_optimal M gamma vf D) t). lra. }
  intros V V' HV HV' s. now rewrite (U V HV s), (U V' HV' s).
Qed.
End Expectile.
