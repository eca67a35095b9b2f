within DockingHIL;
model LabContact "DockingContact with what a real contact may add: each part is absent when its size is zero"
  parameter Real stiffness(unit="N/m", min=0) = 176e3 "Contact stiffness of either frame";
  parameter Real damping(unit="N.s/m", min=0) = 0 "Contact damping of either frame";
  parameter Real front(quantity="Length", unit="m") = 0.005 "Position of the front frame's surface";
  parameter Real rear(quantity="Length", unit="m") = -0.005 "Position of the rear frame's surface";
  parameter Real asymmetry(unit="1") = 0 "What the rear frame is stiffer by, and the front frame softer, relative";
  parameter Real softening(unit="1/s") = 0 "Loss of stiffness per time, relative";
  parameter Real cubic(unit="1") = 0 "Hardening at cubic_depth, relative";
  parameter Real cubic_depth(quantity="Length", unit="m", min=0) = 1e-3 "Depth at which the hardening is told";
  parameter Real hertz_exponent(unit="1") = 0 "Exponent of the force over the depth, less 1";
  parameter Real hertz_depth(quantity="Length", unit="m", min=0) = 5e-4 "Depth at which the power law has the stiffness";
  parameter Real second_stiffness(unit="1") = 0 "Further stiffness from second_depth on, relative";
  parameter Real second_depth(quantity="Length", unit="m", min=0) = 5e-4 "Depth at which it engages";
  parameter Real hunt_crossley(unit="N.s/m2") = 0 "Damping in proportion to the depth";
  parameter Real maxwell(unit="1") = 0 "Stiffness of a relaxing element in parallel, relative";
  parameter Real maxwell_time(quantity="Time", unit="s", min=0) = 0.01 "Time in which it relaxes";
  parameter Real plastic_set(unit="1", min=0) = 0 "Permanent set over the deepest penetration of a contact; below 1";
  parameter Real friction(unit="1") = 0 "Force against the direction of penetration, relative";
  parameter Real friction_velocity(quantity="Velocity", unit="m/s", min=0) = 1e-3 "Speed at which it is fully there";
  parameter Real compliance(unit="m/N", min=0) = 0 "Compliance of a mount in series";
  parameter Real adhesion(quantity="Force", unit="N", min=0) = 0 "Pull while the surfaces part";
  parameter Real adhesion_range(quantity="Length", unit="m", min=0) = 3e-5 "Distance over which it falls to 1/e";
  input Real position(quantity="Length", unit="m", start=0) "Position of the rod tip";
  input Real velocity(quantity="Velocity", unit="m/s", start=0) "Velocity of the rod tip";
  output Real force(quantity="Force", unit="N") "Contact force on the rod";
  output Real penetration(quantity="Length", unit="m") "Depth of the rod tip in the frame it touches";
protected
  constant Real set_time(quantity="Time", unit="s") = 2e-5 "Within which the deepest penetration is remembered";
  constant Real forget_time(quantity="Time", unit="s") = 1e-3 "Within which a contact is forgotten";
  constant Real least(quantity="Length", unit="m") = 1e-12 "Depth below which a power law is not told";
  Real side(unit="1") "1 in the front frame, -1 in the rear frame, 0 between them";
  Real rate(quantity="Velocity", unit="m/s") "Velocity into the frame";
  Real own(unit="N/m") "Stiffness of the frame that is touched, at this time";
  Real factor(unit="1") "Stiffness at this depth over that of the frame";
  Real unloading(quantity="Length", unit="m") "What a permanent set takes from the depth";
  Real further(quantity="Length", unit="m") "Deflection of what is added to the spring";
  Real push(quantity="Force", unit="N") "Force of the frame on the rod, may be negative";
  Real relaxing(quantity="Length", unit="m", start=0, fixed=true) "Deflection of the relaxing element's spring";
  Real deepest(quantity="Length", unit="m", start=0, fixed=true) "Deepest penetration of this contact";
equation
  side = if position > front then 1 elseif position < rear then -1 else 0;
  penetration =
    if position > front then position - front
    elseif position < rear then rear - position
    else 0;
  rate = side*velocity;
  own = stiffness*(1 - side*asymmetry)*(1 - softening*time);
  factor = 1 + cubic*(penetration/cubic_depth)^2
    + (exp(hertz_exponent*log(noEvent(max(penetration, least))/hertz_depth)) - 1);
  unloading = noEvent(if penetration < deepest then (penetration - plastic_set*deepest)/(1 - plastic_set) - penetration else 0);
  further = second_stiffness*noEvent(max(penetration - second_depth, 0)) + maxwell*relaxing + unloading;
  push = (own*penetration*factor + damping*rate + own*further + hunt_crossley*penetration*rate)
    *(1 + friction*tanh(rate/friction_velocity))/(1 + own*compliance);
  // As in DockingContact: begins with penetration, ends where the law would pull.
  force = adhesion*noEvent(
      if velocity < 0 then exp(-abs(position - front)/adhesion_range)
      elseif velocity > 0 then -exp(-abs(position - rear)/adhesion_range)
      else 0) + (
    if position > front and push > 0 then -push
    elseif position < rear and push > 0 then push
    else 0);
  der(relaxing) = noEvent(
    if not (maxwell > 0 or maxwell < 0) then 0
    elseif penetration > 0 then rate - relaxing/maxwell_time
    else -relaxing/forget_time);
  der(deepest) = noEvent(
    if not plastic_set > 0 then 0
    elseif penetration > deepest then (penetration - deepest)/set_time
    elseif penetration > 0 then 0
    else -deepest/forget_time);
  assert(plastic_set < 1, "plastic_set is not below 1; allowed: 0 to below 1");
  assert(hertz_depth > 0 and cubic_depth > 0 and friction_velocity > 0 and maxwell_time > 0 and adhesion_range > 0,
    "hertz_depth, cubic_depth, friction_velocity, maxwell_time or adhesion_range is 0; allowed: above 0");
  annotation (Documentation(info="<html>
<p>With depth d and its rate d' at the frame that is touched, of stiffness
k = stiffness (1 -+ asymmetry) (1 - softening t):
F = (k d (1 + cubic (d/d_c)^2 + (d/d_h)^e - 1) + c d' + h d d' + k r max(0, d - d_2)
+ k m z + k s) (1 + f tanh(d'/v_0))/(1 + k compliance), never below 0. The relaxing element has
z' = d' - z/T; unloading from the deepest penetration d_m along (d - p d_m)/(1 - p) makes
s = (d - p d_m)/(1 - p) - d. Both are forgotten between contacts. While the rod leaves a frame, A exp(-|g|/r) pulls
it back, g the gap between their surfaces, negative in contact.</p>
</html>"));
end LabContact;
