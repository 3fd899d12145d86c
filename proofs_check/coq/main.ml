(* Runs the extracted programs of kernel.ml on models from standard input, one a line; one line
   of output for each. All fields are integers separated by single spaces. States are 0..n-1,
   actions 0..m-1.

   main label
     input   n m  next(0,0) next(0,1) ... next(n-1,m-1)  fail(0) ... fail(n-1)
             next is a state, or -1 where the action is not available; fail is 0 or 1. The
             rows of fail states are ignored; every other state needs an available action.
     output  label(0) ... label(n-1)  time(0) ... time(n-1)
             labels: FAIL 0, DEAD 1, SAFE 2; time: the survival time, -1 if the state is safe.

   main check
     input   kind n m  mode(0) ... mode(n-1)  transitions
             label(0) ... label(n-1)  rank(0) ... rank(n-1)
             escape(0) ... escape(n-1)  action(0) ... action(n-1)
             kind: 0 for deterministic models, 1 for stochastic ones. mode: 0 for ordinary
             states, 1 for fail states, 2 for terminal ones (goals). transitions: for each
             state and action, in the order (0,0) (0,1) ... (n-1,m-1), the number k of possible
             successors and then these k states; k = 0 where the action is not available. The
             transitions of fail and terminal states are ignored. Labels: FAIL 0, DEAD 1,
             SAFE 2, AT_RISK 3; action: -1 for none.
     output  accept or reject. What is accepted is true: CheckerTheorems.v.

   A line that cannot be read ends the program: status 2, a message with the line's number. *)

exception Unreadable of string

(* The next integer of a line, from a position that moves on. *)
let reader line =
  let length = String.length line in
  let position = ref 0 in
  let rec stop i = if i < length && line.[i] <> ' ' then stop (i + 1) else i in
  let next () =
    if !position >= length then raise (Unreadable "too few numbers");
    let until = stop !position in
    let word = String.sub line !position (until - !position) in
    position := until + 1;
    match int_of_string_opt word with
    | Some number -> number
    | None -> raise (Unreadable ("not an integer: '" ^ word ^ "'"))
  and finish () = if !position < length then raise (Unreadable "too many numbers") in
  (next, finish)

let size what number =
  if number < 0 then raise (Unreadable (what ^ " is negative"));
  number

(* Array.init reads in order of the index. *)
let row count next = Array.init count (fun _ -> next ())

let label line =
  let next, finish = reader line in
  let n = size "n" (next ()) in
  let m = size "m" (next ()) in
  let table = Array.init n (fun _ -> row m next) in
  let fail = Array.map (fun bit -> bit <> 0) (row n next) in
  finish ();
  let successors state choices =
    if fail.(state) then [ state ]
    else
      match List.filter (fun target -> target <> -1) (Array.to_list choices) with
      | [] -> raise (Unreadable "a state without an action")
      | targets ->
          if List.exists (fun target -> target < 0 || target >= n) targets then
            raise (Unreadable "a successor out of range");
          targets
  in
  let rows = Array.to_list (Array.mapi successors table) in
  let times = Kernel.survival_times rows (Array.to_list fail) in
  let label_of = function None -> "2" | Some 0 -> "0" | Some _ -> "1" in
  let time_of = function None -> "-1" | Some time -> string_of_int time in
  String.concat " " (List.map label_of times @ List.map time_of times)

let check line =
  let next, finish = reader line in
  let deterministic = next () = 0 in
  let n = size "n" (next ()) in
  let m = size "m" (next ()) in
  let mode = row n next in
  let successors _ = Array.to_list (row (size "a number of successors" (next ())) next) in
  let transitions = Array.init n (fun _ -> Array.to_list (Array.init m successors)) in
  let label = row n next in
  let rank = row n next in
  let escape = row n next in
  let action = row n next in
  finish ();
  let inside = Array.for_all (fun state -> state >= 0) in
  let readable =
    Array.for_all (fun code -> code >= 0 && code <= 3) label
    && inside rank && inside escape
    && Array.for_all (fun choice -> choice >= -1) action
    && Array.for_all (List.for_all (List.for_all (fun target -> target >= 0))) transitions
  in
  let label_of state =
    match label.(state) with
    | 0 -> Kernel.FAIL
    | 1 -> Kernel.DEAD
    | 2 -> Kernel.SAFE
    | _ -> Kernel.AT_RISK
  in
  let accepted =
    readable
    && Kernel.check_certificate n
         (fun state -> mode.(state) = 1)
         (fun state -> mode.(state) = 2)
         (fun state -> transitions.(state))
         label_of
         (fun state -> rank.(state))
         (fun state -> escape.(state))
         (fun state -> if action.(state) < 0 then None else Some action.(state))
         deterministic
  in
  if accepted then "accept" else "reject"

let () =
  let answer =
    match Sys.argv with
    | [| _; "label" |] -> label
    | [| _; "check" |] -> check
    | _ ->
        prerr_endline "usage: main label|check < MODELS";
        exit 2
  in
  let number = ref 0 in
  try
    while true do
      let line = input_line stdin in
      incr number;
      print_string (answer line);
      print_char '\n'
    done
  with
  | End_of_file -> ()
  | Unreadable why ->
      Printf.eprintf "line %d: %s\n" !number why;
      exit 2
