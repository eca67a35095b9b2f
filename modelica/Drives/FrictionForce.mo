within Drives;
model FrictionForce "Friction along a path, by the usual laws: each part is absent when its size is zero"
  parameter Real viscous(unit="N.s/m") = 0 "Force per velocity";
  parameter Real one_sided(unit="N.s/m") = 0 "Force per speed: more in one direction than in the other";
  parameter Real drag(unit="N.s2/m2") = 0 "Force per square of velocity, of a turbulent flow";
  parameter Real stiffness(unit="N/m") = 0 "Force per path since the start: a parallel spring";
  parameter Real level(quantity="Force", unit="N", min=0) = 0 "Dry friction of fast sliding";
  parameter Real excess(unit="1", min=0) = 0 "By which share breaking away takes more";
  parameter Real stribeck_velocity(quantity="Velocity", unit="m/s", min=0) = 0.01 "Speed over which the excess goes";
  parameter Real width(quantity="Velocity", unit="m/s", min=0) = 1e-4
    "Speed at which dry friction without a distance reaches 71 % of the level";
  parameter Real distance(quantity="Length", unit="m", min=0) = 0
    "Path over which dry friction builds up, as Dahl and LuGre have it; 0 m: at once";
  parameter Real slip_level(quantity="Force", unit="N", min=0) = 0 "Force of four springs in parallel that all slip";
  parameter Real slip_distance(quantity="Length", unit="m", min=0) = 0.001 "Path after which all of them slip";
  parameter Real bearing_level(quantity="Force", unit="N", min=0) = 0 "Force at which one spring slips";
  parameter Real bearing_distance(quantity="Length", unit="m", min=0) = 0.001 "Bending at which it slips";
  parameter Real play(quantity="Length", unit="m", min=0) = 0 "Way between its bearing on either side";
  input Real velocity(quantity="Velocity", unit="m/s", start=0) "Velocity of what rubs";
  output Real force(quantity="Force", unit="N") "Force with which it has to be moved";
protected
  Real path(quantity="Length", unit="m", start=0, fixed=true) "Path since the start";
  Real built(unit="1", start=0, fixed=true) "Dry friction that was built up along the path, over the level";
  Real bent_1(quantity="Length", unit="m", start=0, fixed=true) "Bending of the spring that slips first";
  Real bent_2(quantity="Length", unit="m", start=0, fixed=true) "Of the second";
  Real bent_3(quantity="Length", unit="m", start=0, fixed=true) "Of the third";
  Real bent_4(quantity="Length", unit="m", start=0, fixed=true) "Of the last";
  Real bent(quantity="Length", unit="m", start=0, fixed=true) "Bending of the spring with play";
  Real curve(unit="1") "Dry friction of steady sliding over the level, at this speed";
  Real dry(unit="1") "Dry friction over the level";
  Real slipping(unit="1") "Share of the force of the four springs";
  Real bearing(unit="1") "Share of the force of the spring with play";
equation
  der(path) = velocity;
  curve = 1 + excess*exp(-(velocity/stribeck_velocity)^2);
  der(built) = noEvent(if distance > 0 then (curve*velocity - built*abs(velocity))/distance else 0);
  // noEvent throughout: a spring that stays at its limit would raise event after event.
  dry = noEvent(if distance > 0 then built else curve*velocity/sqrt(velocity*velocity + width*width));
  der(bent_1) = noEvent(if bent_1*velocity > 0 and abs(bent_1) >= slip_distance/8 then 0 else velocity);
  der(bent_2) = noEvent(if bent_2*velocity > 0 and abs(bent_2) >= slip_distance/4 then 0 else velocity);
  der(bent_3) = noEvent(if bent_3*velocity > 0 and abs(bent_3) >= slip_distance/2 then 0 else velocity);
  der(bent_4) = noEvent(if bent_4*velocity > 0 and abs(bent_4) >= slip_distance then 0 else velocity);
  slipping = noEvent((min(max(bent_1*8/slip_distance, -1), 1) + min(max(bent_2*4/slip_distance, -1), 1)
    + min(max(bent_3*2/slip_distance, -1), 1) + min(max(bent_4/slip_distance, -1), 1))/4);
  der(bent) = noEvent(if bent*velocity > 0 and abs(bent) >= play/2 + bearing_distance then 0 else velocity);
  bearing = noEvent(min(max((bent - play/2)/bearing_distance, 0), 1) - min(max((-bent - play/2)/bearing_distance, 0), 1));
  force = viscous*velocity + noEvent(one_sided*abs(velocity) + drag*velocity*abs(velocity)) + stiffness*path
    + level*dry + slip_level*slipping + bearing_level*bearing;
  assert(width > 0 and stribeck_velocity > 0,
    "width or stribeck_velocity is 0 m/s; allowed: above 0 m/s, such as 0.1 mm/s and 10 mm/s");
  assert(slip_distance > 0 and bearing_distance > 0,
    "slip_distance or bearing_distance is 0 m; allowed: above 0 m, such as 1 mm");
  annotation (Documentation(info="<html>
<p>F = b v + b_1 |v| + c v |v| + k x + F_c d + F_m s + F_b u. Dry friction d is g(v) v/sqrt(v^2 + v_w^2) with
g(v) = 1 + e exp(-(v/v_s)^2) (Coulomb, Stribeck), or where a distance is given, dd/dx = (g(v) sgn(v) - d)/D
along the path (Dahl, and LuGre without damping of its bristles). The share s is that of four springs in
parallel that slip at a quarter of the force each, after 1/8, 1/4, 1/2 and 1 times a distance (Maxwell slip,
Iwan). The share u is that of one spring that slips, with play before it bears (presliding, backlash).</p>
</html>"));
end FrictionForce;
