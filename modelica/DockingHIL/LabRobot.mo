within DockingHIL;
model LabRobot "RobotResponse with what a real robot may add: each part is absent when its size is zero"
  parameter Real omega_n(quantity="AngularVelocity", unit="rad/s", displayUnit="Hz", min=0) = 471.23889803846896
    "Undamped natural frequency (75 Hz)";
  parameter Real xi_n(unit="1", min=0) = 0.8 "Damping ratio";
  parameter Real tau_m(quantity="Time", unit="s", min=0) = 0.002 "Pure delay of the response";
  parameter Real start_position(quantity="Length", unit="m") = 0 "Position of the rod tip at the start";
  parameter Real start_velocity(quantity="Velocity", unit="m/s") = 0 "Velocity of the rod tip at the start";
  parameter Real approach_period(quantity="Time", unit="s", min=0) = 0
    "Tick of the commands before the start, at start_velocity towards 0 m; 0 s: the first command stood";
  parameter Real skew(unit="1") = 0 "Growth of the delay per time";
  parameter Real friction(quantity="Acceleration", unit="m/s2", min=0) = 0 "Coulomb friction over the moved mass";
  parameter Real stribeck(unit="1", min=0) = 0 "Friction at rest in excess of Coulomb's, relative";
  parameter Real friction_velocity(quantity="Velocity", unit="m/s", min=0) = 2e-4 "Speed at which friction is fully there";
  parameter Real stribeck_velocity(quantity="Velocity", unit="m/s", min=0) = 2e-3 "Speed at which the excess has gone";
  parameter Real load_sensitivity(unit="m/(s2.N)") = 0 "Acceleration by force on the rod";
  parameter Real acceleration_limit(quantity="Acceleration", unit="m/s2", min=0) = 0 "Largest acceleration; 0 m/s2: none";
  parameter Real rate_limit(quantity="Velocity", unit="m/s", min=0) = 0 "Largest speed; 0 m/s: none";
  parameter Real backlash(quantity="Length", unit="m", min=0) = 0 "Whole play at the output of the drive";
  parameter Real resonance_gain(unit="1") = 0 "Share of the servo's acceleration that excites the structure";
  parameter Real resonance_frequency(quantity="AngularVelocity", unit="rad/s", displayUnit="Hz", min=0) = 100
    "Natural frequency of the structure";
  parameter Real resonance_damping(unit="1", min=0) = 0.03 "Damping ratio of the structure";
  input Real command(quantity="Length", unit="m", start=0) "Commanded position of the rod tip";
  input Real force(quantity="Force", unit="N", start=0) "Contact force on the rod, for load_sensitivity";
  output Real position(quantity="Length", unit="m") "Position of the rod tip";
  output Real velocity(quantity="Velocity", unit="m/s") "Velocity of the rod tip";
protected
  constant Real moment(quantity="Time", unit="s") = 5e-5 "Within which a limit of speed and a play act";
  Real tau(quantity="Time", unit="s") "Delay now";
  Real late_command(quantity="Length", unit="m") "Command that was sent so long ago, the first one before the start";
  Real delayed_command(quantity="Length", unit="m") "Command that reaches the servo now";
  Real x(quantity="Length", unit="m", start=start_position, fixed=true) "Position of the servo";
  Real v(quantity="Velocity", unit="m/s", start=start_velocity, fixed=true) "Velocity of the servo";
  Real acceleration(quantity="Acceleration", unit="m/s2") "Acceleration of the servo";
  Real linear(quantity="Acceleration", unit="m/s2") "Acceleration by the linear servo alone";
  Real disturbed(quantity="Acceleration", unit="m/s2") "With friction and load";
  Real bounded(quantity="Acceleration", unit="m/s2") "Within its limit";
  Real driven(quantity="Length", unit="m", start=start_position, fixed=true) "Position behind the play";
  Real driven_rate(quantity="Velocity", unit="m/s") "Velocity behind the play";
  Real ahead(quantity="Length", unit="m") "Where the servo is a moment later, seen from behind the play";
  Real bend(quantity="Length", unit="m", start=0, fixed=true) "Deflection of the structure";
  Real bend_rate(quantity="Velocity", unit="m/s", start=0, fixed=true) "Its rate";
equation
  tau = noEvent(max(tau_m + skew*time, 0));
  late_command = delay(command, tau);
  delayed_command = noEvent(
    if approach_period > 0 and time < tau - 1e-9 then start_velocity*approach_period*(floor((time - tau)/approach_period + 1e-6) + 1)
    else late_command);
  linear = omega_n^2*(delayed_command - x) - 2*xi_n*omega_n*v;
  disturbed = linear + load_sensitivity*force
    - friction*tanh(v/friction_velocity)*(1 + stribeck*exp(-(v/stribeck_velocity)^2));
  bounded = noEvent(if acceleration_limit > 0 then min(max(disturbed, -acceleration_limit), acceleration_limit) else disturbed);
  // A speed that stays at a limit that switches would raise event after event: it is drawn to its limit.
  acceleration = noEvent(
    if rate_limit > 0 then min(max(bounded, (-rate_limit - v)/moment), (rate_limit - v)/moment) else bounded);
  der(x) = v;
  der(v) = acceleration;
  // A play that takes its output along at once would make it a state that jumps into step. The servo's speed
  // makes up for the moment that this takes.
  ahead = x + moment*v - driven;
  driven_rate = noEvent(if backlash > 0 then (max(ahead - 0.5*backlash, 0) - max(-ahead - 0.5*backlash, 0))/moment else 0);
  der(driven) = driven_rate;
  der(bend) = bend_rate;
  der(bend_rate) = -resonance_gain*acceleration - resonance_frequency^2*bend
    - 2*resonance_damping*resonance_frequency*bend_rate;
  position = noEvent(if backlash > 0 then driven else x) + bend;
  velocity = noEvent(if backlash > 0 then driven_rate else v) + bend_rate;
  assert(friction_velocity > 0 and stribeck_velocity > 0,
    "friction_velocity or stribeck_velocity is 0 m/s; allowed: above 0 m/s, such as 0.2 mm/s and 2 mm/s");
  annotation (Documentation(info="<html>
<p>x'' = omega_n^2 (c - x) - 2 xi_n omega_n x' with c the command tau_m + skew t ago (Eq. 17), to which come
load_sensitivity F and -friction tanh(x'/v_0) (1 + stribeck exp(-(x'/v_s)^2)); bounded in acceleration and in
speed. The rod tip stands at x, or behind a play of the given width, plus the deflection q of a structure,
q'' + 2 z w q' + w^2 q = -g x''.</p>
</html>"));
end LabRobot;
