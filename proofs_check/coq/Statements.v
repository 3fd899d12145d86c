(** * What is claimed: the definitions and the statements, without a proof.

    Each [..._statement] is proved, under the same name, in Theorems.v.  The
    models are all finite ones; policies are stochastic; [gamma] is the safety
    discount [gamma_safe] in (0,1), [eps] the threshold [epsilon_safe].  *)
From Coq Require Import List Reals.
Import ListNotations.
Open Scope R_scope.

(** ** Finite distributions: lists of (probability, outcome). *)
Definition Dist (A : Type) := list (R * A).
Definition total {A} (l : list A) (f : A -> R) : R := fold_right (fun x r => f x + r) 0 l.
Definition expect {A} (d : Dist A) (f : A -> R) : R := total d (fun o => fst o * f (snd o)).
Definition IsDist {A} (d : Dist A) := (forall o, In o d -> 0 <= fst o) /\ total d fst = 1.
Definition Supp {A} (d : Dist A) (x : A) := exists p, 0 < p /\ In (p, x) d.
Definition dirac {A} (x : A) : Dist A := [(1, x)].

(** ** Labels, on a graph whose every state has an edge. *)
Section Graph.
Context {St : Type} (edge : St -> St -> Prop) (fail : St -> bool).
Definition IsPath (w : nat -> St) := forall i, edge (w i) (w (S i)).
Definition Dead s := fail s = false /\ forall w, IsPath w -> w 0%nat = s -> exists k, fail (w k) = true.
Definition Safe s := fail s = false /\ ~ Dead s.
Definition ForcedWithin n s := forall w, IsPath w -> w 0%nat = s -> exists k, (k <= n)%nat /\ fail (w k) = true.
(** T(s) = n: failure is forced within n steps, and within no fewer. *)
Definition SurvivalTime s n := ForcedWithin n s /\ forall m, ForcedWithin m s -> (n <= m)%nat.
End Graph.
(** Labels when an action has several possible successors (P_min = 0, P_min < 1). *)
Section Qualitative.
Context {St A : Type} (avail : St -> A -> Prop) (succ : St -> A -> St -> Prop) (fail : St -> bool).
(** Failure can be avoided for sure: s lies in a fail-free set that some action keeps. *)
Definition Avoidable s := exists Z : St -> Prop, Z s /\ forall t, Z t -> fail t = false /\
  exists a, avail t a /\ forall u, succ t a u -> Z u.
(** Such a set can be reached before failure. *)
Inductive CanEscape : St -> Prop :=
| escape_now s : Avoidable s -> CanEscape s
| escape_step s a t : fail s = false -> avail s a -> succ s a t -> CanEscape t -> CanEscape s.
End Qualitative.

(** ** Finite safe Markov decision processes.  The actions of a fail state are never used. *)
Record MDP := {
  State : Type; Action : Type;
  states : list State; states_all : forall s, In s states;
  actions : State -> list Action; actions_some : forall s, actions s <> [];
  step : State -> Action -> Dist State; step_dist : forall s a, IsDist (step s a);
  fail : State -> bool }.

Section Model.
Variable M : MDP.
Definition avail (s : State M) (a : Action M) := In a (actions M s).
Definition succ (s : State M) (a : Action M) (t : State M) := Supp (step M s a) t.
Definition edge s t := exists a, avail s a /\ succ s a t.
Definition dead := Dead edge (fail M).
Definition safe := Safe edge (fail M).
Definition time := SurvivalTime edge (fail M).
Definition Deterministic (next : State M -> Action M -> State M) := forall s a, step M s a = dirac (next s a).
(** H_b: the longest survival time that one action enters from a safe state. *)
Definition BoundaryHorizon h := (exists s t, safe s /\ edge s t /\ time t h) /\
  forall s t n, safe s -> edge s t -> time t n -> (n <= h)%nat.
Definition NoUnsafeSuccessor := forall s t, safe s -> edge s t -> safe t.

Definition Policy := State M -> Dist (Action M).
Definition IsPolicy (pi : Policy) := forall s, IsDist (pi s) /\ forall a, Supp (pi s) a -> avail s a.
Definition pure (choose : State M -> Action M) : Policy := fun s => dirac (choose s).

(** ** Values.  The cost is 1 on entering fail; the critic is the target of the paper's loss,
    c + (1 - c) gamma V(s').  [vf] is V(fail): 0 by the paper's definition, 1 by its Lemma 1. *)
Variables gamma vf : R.
Definition target (V : State M -> R) t := if fail M t then 1 else gamma * V t.
Definition Q V s a := expect (step M s a) (target V).
Definition backup (pi : Policy) V s := if fail M s then vf else expect (pi s) (Q V s).
(** The expected discounted cost of the first n steps, and its limit. *)
Fixpoint cost pi n s := match n with O => 0 | S m => backup pi (cost pi m) s end.
Definition IsValue pi V := forall s, Un_cv (fun n => cost pi n s) (V s).
Definition IsOptimal V :=
  (forall pi Vpi, IsPolicy pi -> IsValue pi Vpi -> forall s, V s <= Vpi s) /\
  exists pi, IsPolicy pi /\ IsValue pi V.
(** eps is at most gamma^T(t) for every unsafe t that a safe state can enter. *)
Definition SoundThreshold eps := forall s t n, safe s -> edge s t -> time t n -> eps <= gamma ^ n.
(** The policy sets, in both readings, over a region of states. *)
Definition Critic := State M -> Action M -> R.
Definition PerAction (region : State M -> Prop) (q : Critic) eps (pi : Policy) :=
  forall s a, region s -> Supp (pi s) a -> q s a < eps.
Definition InExpectation (region : State M -> Prop) (q : Critic) eps (pi : Policy) :=
  forall s, region s -> expect (pi s) (q s) < eps.
(** Behavior correction: action b is executed when the task policy proposes a. *)
Definition Argmin (q : Critic) s b := avail s b /\ forall a, avail s a -> q s b <= q s a.
Definition Executes gate recovery eps s a b :=
  (gate s a < eps /\ b = a) \/ (eps <= gate s a /\ Argmin recovery s b).
(** The closed loop: any available proposals, any tie-break among the minimisers. *)
Definition ClosedLoop gate recovery eps (w : nat -> State M) := forall i, exists a b,
  avail (w i) a /\ Executes gate recovery eps (w i) a b /\ succ (w i) b (w (S i)).
Definition StaysSafe gate recovery eps :=
  forall w, ClosedLoop gate recovery eps w -> safe (w 0%nat) -> forall k, safe (w k).
(** What the paper trains: V minimises the expectile loss of Q under the data policy mu. *)
Definition expectile_loss tau u := (if Rlt_dec u 0 then 1 - tau else tau) * (u * u).
Definition IsExpectile tau (d : Dist (Action M)) (f : Action M -> R) m :=
  forall x, expect d (fun a => expectile_loss tau (f a - m)) <= expect d (fun a => expectile_loss tau (f a - x)).
Definition IsExpectileValue tau (mu : Policy) V :=
  forall s, if fail M s then V s = vf else IsExpectile tau (mu s) (Q V s) (V s).

(** ** Undiscounted: failure within n steps; policies and proposals may depend on the past. *)
Definition HistoryPolicy := list (State M) -> Policy.
Fixpoint failing (pi : HistoryPolicy) n past s : R :=
  if fail M s then 1 else match n with
  | O => 0 | S m => expect (pi past s) (fun a => expect (step M s a) (failing pi m (s :: past))) end.
(** X = P_min(eventually fail), attained by a memoryless policy. *)
Definition IsMinFailure X :=
  (forall pi, (forall past, IsPolicy (pi past)) ->
     forall s p, Un_cv (fun n => failing pi n [] s) p -> X s <= p) /\
  exists choose, IsPolicy (pure choose) /\
     forall s, Un_cv (fun n => failing (fun _ => pure choose) n [] s) (X s).
Definition chance (X : State M -> R) s a := expect (step M s a) X.
Definition corrected X eps (rec : State M -> Action M) s a := if Rlt_dec (chance X s a) eps then a else rec s.
(** Probability that the corrected agent has not failed after n steps. *)
Fixpoint surviving X eps rec (task : HistoryPolicy) n past s : R :=
  if fail M s then 0 else match n with
  | O => 1 | S m => expect (task past s) (fun a =>
             expect (step M s (corrected X eps rec s a)) (surviving X eps rec task m (s :: past))) end.
Definition prob (d : Dist (State M)) (B : State M -> bool) := expect d (fun t => if B t then 1 else 0).
End Model.

(** * The statements *)
Definition Discount gamma vf := 0 < gamma < 1 /\ 0 <= vf <= 1.
(** ** Labels and horizon (all finite models; with chance, "dead" means: all paths fail) *)
Definition Partition_statement : Prop := forall M s,
  (fail M s = true \/ dead M s \/ safe M s) /\
  (safe M s <-> exists w, IsPath (edge M) w /\ w 0%nat = s /\ forall k, fail M (w k) = false) /\
  (safe M s -> exists t, edge M s t /\ safe M t).
(** Assumption 1 holds by itself: H <= |S_dead| ([D] is any list that holds the dead states). *)
Definition Horizon_statement : Prop := forall M (D : list (State M)) s, (forall t, dead M t -> In t D) ->
  dead M s -> exists n, (1 <= n <= length D)%nat /\ time M s n.
Definition Acyclic_statement : Prop := forall M w i j, IsPath (edge M) w -> (i < j)%nat ->
  (forall k, (i <= k <= j)%nat -> dead M (w k)) -> w i <> w j.
Definition SurvivalTime_statement : Prop := forall M s,
  ((exists n, time M s n) <-> ~ safe M s) /\ (time M s 0 <-> fail M s = true) /\
  forall n, time M s (S n) <-> fail M s = false /\
    (forall t, edge M s t -> exists k, (k <= n)%nat /\ time M t k) /\ exists t, edge M s t /\ time M t n.
(** Dead-ends are the same if only memoryless policies are quantified over, as in the paper. *)
Definition MemorylessDead_statement : Prop := forall M next, Deterministic M next -> forall s,
  dead M s <-> fail M s = false /\ forall choose, IsPolicy M (pure M choose) ->
    exists n, fail M (Nat.iter n (fun t => next t (choose t)) s) = true.
Definition Threshold_statement : Prop := forall M gamma eps, 0 < gamma < 1 ->
  ((exists h, BoundaryHorizon M h) \/ NoUnsafeSuccessor M) /\
  (forall h, BoundaryHorizon M h -> (SoundThreshold M gamma eps <-> eps <= gamma ^ h)) /\
  (NoUnsafeSuccessor M -> SoundThreshold M gamma eps) /\
  (forall H, (forall s n, dead M s -> time M s n -> (n <= H)%nat) -> eps <= gamma ^ H ->
     SoundThreshold M gamma eps /\ forall h, BoundaryHorizon M h -> (h <= H)%nat).
(** ** Existence of the values (all finite models) *)
Definition Value_exists_statement : Prop := forall M gamma vf pi, Discount gamma vf -> IsPolicy M pi ->
  exists V, IsValue M gamma vf pi V /\ forall V', IsValue M gamma vf pi V' <->
    (forall s, 0 <= V' s <= 1) /\ forall s, V' s = backup M gamma vf pi V' s.
Definition Optimal_exists_statement : Prop := forall M gamma vf, Discount gamma vf ->
  exists V, IsOptimal M gamma vf V /\ forall V', IsOptimal M gamma vf V' <->
    (forall s, 0 <= V' s <= 1) /\ (forall s, fail M s = true -> V' s = vf) /\
    forall s, fail M s = false -> (forall a, avail M s a -> V' s <= Q M gamma V' s a) /\
                                  exists a, avail M s a /\ V' s = Q M gamma V' s a.
(** ** Deterministic models: V is the value of a policy pi, W the optimal one. *)
Definition Solved M next gamma vf pi V W := Discount gamma vf /\ Deterministic M next /\
  IsPolicy M pi /\ IsValue M gamma vf pi V /\ IsOptimal M gamma vf W.
Definition Lemma1_bullet1_statement : Prop := forall M gamma vf pi V W s, Discount gamma vf ->
  IsValue M gamma vf pi V -> IsOptimal M gamma vf W -> fail M s = true ->
  V s = vf /\ W s = vf /\ target M gamma V s = 1.
Definition Lemma1_bullet2_statement : Prop := forall M next gamma vf pi V W s,
  Solved M next gamma vf pi V W -> dead M s ->
  W s <= V s /\ (forall n, time M s (S n) -> W s = gamma ^ n /\ target M gamma W s = gamma ^ S n) /\
  forall H, (forall t n, dead M t -> time M t n -> (n <= H)%nat) ->
    gamma ^ (H - 1) <= W s /\ gamma ^ H <= target M gamma W s.
Definition Lemma1_bullet3_statement : Prop := forall M next gamma vf pi V W s,
  Solved M next gamma vf pi V W -> safe M s -> 0 <= V s /\ W s = 0.
Definition Positive_value_statement : Prop := forall M next gamma vf pi V W s,
  Solved M next gamma vf pi V W -> 0 < W s <-> dead M s \/ (fail M s = true /\ 0 < vf).
(** The gate of Q^pi is sound, for any policy; every minimiser of Q* is safe; both together. *)
Definition Theorem2_task_statement : Prop := forall M next gamma vf pi V W eps s a,
  Solved M next gamma vf pi V W -> SoundThreshold M gamma eps ->
  safe M s -> avail M s a -> Q M gamma V s a < eps -> safe M (next s a).
Definition Theorem2_recovery_statement : Prop := forall M next gamma vf pi V W s b,
  Solved M next gamma vf pi V W -> safe M s -> Argmin M (Q M gamma W) s b -> safe M (next s b).
Definition Theorem2_statement : Prop := forall M next gamma vf pi V W eps,
  Solved M next gamma vf pi V W -> SoundThreshold M gamma eps ->
  StaysSafe M (Q M gamma W) (Q M gamma W) eps /\ StaysSafe M (Q M gamma V) (Q M gamma W) eps.
(** Allowed <=> leads to a safe state, exactly for the sound thresholds; above them, a way out. *)
Definition Exactness_statement : Prop := forall M next gamma vf pi V W eps,
  Solved M next gamma vf pi V W -> 0 < eps ->
  (SoundThreshold M gamma eps <->
   forall s a, safe M s -> avail M s a -> (Q M gamma W s a < eps <-> safe M (next s a))).
Definition Tightness_statement : Prop := forall M next gamma vf pi V W eps h,
  Solved M next gamma vf pi V W -> BoundaryHorizon M h -> gamma ^ h < eps ->
  exists s a, safe M s /\ avail M s a /\ ~ safe M (next s a) /\
    forall recovery b, Executes M (Q M gamma W) recovery eps s a b -> b = a.
(** The paper's sentence about RRL (critic and recovery from Q^pi), its refutation, its repair. *)
Definition RRL_claim : Prop := forall M next gamma vf pi V W eps, Solved M next gamma vf pi V W ->
  0 < eps -> SoundThreshold M gamma eps -> StaysSafe M (Q M gamma V) (Q M gamma V) eps.
Definition RRL_refuted_statement : Prop := ~ RRL_claim /\
  exists M next task s, Deterministic M next /\ length (states M) = 5%nat /\
  IsPolicy M (pure M task) /\ safe M s /\
  forall gamma vf eps V, Discount gamma vf -> IsValue M gamma vf (pure M task) V ->
  let rrl := Executes M (Q M gamma V) (Q M gamma V) eps s (task s) in
  (exists b, rrl b) /\ forall b, rrl b -> dead M (next s b).
Definition RRL_repaired_statement : Prop := forall M next gamma vf pi V W eps,
  Solved M next gamma vf pi V W -> SoundThreshold M gamma eps ->
  (forall s, safe M s -> exists a, avail M s a /\ Q M gamma V s a < eps) ->
  StaysSafe M (Q M gamma V) (Q M gamma V) eps.
Definition SelfReference_statement : Prop := forall M next gamma vf pi V W eps,
  Solved M next gamma vf pi V W -> 0 < eps -> SoundThreshold M gamma eps ->
  let stays := forall s a, safe M s -> Supp (pi s) a -> safe M (next s a) in
  (PerAction M (safe M) (Q M gamma V) eps pi <-> stays) /\
  (PerAction M (safe M) (Q M gamma W) eps pi <-> stays).
(** Learned critics q with uniform error delta: when all of them gate exactly, recover safely. *)
Definition Learned_statement : Prop := forall M next gamma vf pi V W delta,
  Solved M next gamma vf pi V W -> 0 <= delta ->
  let near q := forall s a, avail M s a -> Rabs (q s a - Q M gamma W s a) <= delta in
  (forall eps, (exists s, safe M s) -> (delta < eps /\ SoundThreshold M gamma (eps + delta) <->
     forall q, near q -> forall s a, safe M s -> avail M s a -> (q s a < eps <-> safe M (next s a)))) /\
  (forall h, BoundaryHorizon M h -> (2 * delta < gamma ^ h <->
     forall q, near q -> forall s b, safe M s -> Argmin M q s b -> safe M (next s b))).
(** The expectile critic exists, once; it is at least Q*, and its gate is sound. *)
Definition Expectile_statement : Prop := forall M gamma vf tau mu W,
  Discount gamma vf -> 0 < tau < 1 -> IsPolicy M mu -> IsOptimal M gamma vf W ->
  (exists V, IsExpectileValue M gamma vf tau mu V) /\ forall V, IsExpectileValue M gamma vf tau mu V ->
  (forall V', IsExpectileValue M gamma vf tau mu V' -> forall s, V' s = V s) /\
  (forall s, W s <= V s) /\ (forall s a, Q M gamma W s a <= Q M gamma V s a) /\
  forall next eps, Deterministic M next -> SoundThreshold M gamma eps ->
    forall s a, safe M s -> avail M s a -> Q M gamma V s a < eps -> safe M (next s a).
(** ** Stochastic models *)
(** Theorem 1, for any region (the paper's S_safe is one), both readings. *)
Definition Theorem1_statement : Prop := forall M gamma vf pi V W eps region mu,
  Discount gamma vf -> IsPolicy M pi -> IsValue M gamma vf pi V -> IsOptimal M gamma vf W ->
  (PerAction M region (Q M gamma V) eps mu -> PerAction M region (Q M gamma W) eps mu) /\
  (IsPolicy M mu -> InExpectation M region (Q M gamma V) eps mu -> InExpectation M region (Q M gamma W) eps mu).
(** The probability of entering fail or states all of whose paths fail, in one step. *)
Definition OneStep_statement : Prop := forall M gamma vf W B H s a,
  Discount gamma vf -> IsOptimal M gamma vf W ->
  (forall t, B t = true -> ForcedWithin (edge M) (fail M) H t) ->
  prob M (step M s a) B <= Q M gamma W s a / gamma ^ H.
Definition MinFailure_exists_statement : Prop := forall M, exists X, IsMinFailure M X /\
  forall X', IsMinFailure M X' -> forall s, X' s = X s.
(** P_min = 0 and P_min < 1 are graph properties. *)
Definition Qualitative_statement : Prop := forall M X s, IsMinFailure M X ->
  (X s = 0 <-> Avoidable (avail M) (succ M) (fail M) s) /\
  (X s < 1 <-> CanEscape (avail M) (succ M) (fail M) s).
(** On P_min = 0, V* = 0, and small thresholds allow exactly the actions that stay there. *)
Definition ZeroSet_statement : Prop := forall M gamma vf W eps, Discount gamma vf -> IsOptimal M gamma vf W ->
  let Z := Avoidable (avail M) (succ M) (fail M) in (forall s, fail M s = false -> (W s = 0 <-> Z s)) /\
  (0 < eps -> (forall s a, Z s -> avail M s a -> Q M gamma W s a = 0 \/ eps <= Q M gamma W s a) ->
   forall s a, Z s -> avail M s a -> (Q M gamma W s a < eps <-> forall t, succ M s a t -> Z t)).
(** The geometric bound, its sharp form, and what it needs of X and the recovery. *)
Definition Superharmonic M X rec := (forall s, 0 <= X s <= 1) /\ (forall s, fail M s = true -> X s = 1) /\
  forall s, fail M s = false -> chance M X s (rec s) <= X s.
Definition Geometric_statement : Prop := forall M X rec eps task,
  0 <= eps <= 1 -> (forall past, IsPolicy M (task past)) ->
  Superharmonic M X rec \/ (IsMinFailure M X /\ forall s, Argmin M (chance M X) s (rec s)) ->
  forall n s, (1 - X s) * (1 - eps) ^ n <= surviving M X eps rec task n [] s /\
  (fail M s = false -> (1 - eps) ^ n * Rmin (1 - X s) (1 - eps) <= surviving M X eps rec task (S n) [] s).
(** Theorem 2 fails with chance: from a state that can avoid failure for sure (X = 0), the
    corrected agent survives n steps with probability (1 - p)^n only. *)
Definition Stochastic_refuted_statement : Prop := forall eps, 0 < eps < 1 ->
  exists M X rec task s p, IsMinFailure M X /\ (forall t, Argmin M (chance M X) t (rec t)) /\
  (forall past, IsPolicy M (task past)) /\ X s = 0 /\ 0 < p < 1 /\
  forall n, surviving M X eps rec task n [] s = (1 - p) ^ n.
