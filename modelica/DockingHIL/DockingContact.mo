within DockingHIL;
model DockingContact "Rod between a front and a rear frame: spring-damper contact that only pushes"
  parameter Real stiffness(unit="N/m", min=0) = 176e3 "Contact stiffness of either frame";
  parameter Real damping(unit="N.s/m", min=0) = 0 "Contact damping of either frame";
  parameter Real front(quantity="Length", unit="m") = 0.005 "Position of the front frame's surface";
  parameter Real rear(quantity="Length", unit="m") = -0.005 "Position of the rear frame's surface";
  input Real position(quantity="Length", unit="m", start=0) "Position of the rod tip";
  input Real velocity(quantity="Velocity", unit="m/s", start=0) "Velocity of the rod tip";
  output Real force(quantity="Force", unit="N") "Contact force on the rod";
  output Real penetration(quantity="Length", unit="m") "Depth of the rod tip in the frame it touches";
protected
  Real front_push(quantity="Force", unit="N") "Spring-damper law at the front frame, may be negative";
  Real rear_push(quantity="Force", unit="N") "Spring-damper law at the rear frame, may be negative";
equation
  front_push = stiffness*(position - front) + damping*velocity;
  rear_push = stiffness*(rear - position) - damping*velocity;
  // Contact begins with penetration and ends where the law would pull: a damped frame is left
  // before the penetration is back at zero.
  force =
    if position > front and front_push > 0 then -front_push
    elseif position < rear and rear_push > 0 then rear_push
    else 0;
  penetration =
    if position > front then position - front
    elseif position < rear then rear - position
    else 0;
  annotation (Documentation(info="<html>
<p>F = -(k d + c d') at the front frame with penetration d = x - front &gt; 0, and
F = k d + c d' at the rear frame with d = rear - x &gt; 0; never a pulling force
(Eqs. 19 to 21 along the contact normal).</p>
<p>The conditions raise events, so a variable-step integrator locates onset and loss of contact.
With damping the force jumps to c d' at onset, as the linear spring-damper law implies.</p>
</html>"));
end DockingContact;
