within DockingHIL;
model PointContact "Rod tip between two frame surfaces in space: spring-damper that only pushes, optional friction"
  parameter Real stiffness(unit="N/m", min=0) = 176e3 "Normal contact stiffness of either frame";
  parameter Real damping(unit="N.s/m", min=0) = 0 "Normal contact damping of either frame";
  parameter Real friction(unit="1", min=0) = 0 "Coulomb friction coefficient; 0: force along the normal alone";
  parameter Real friction_velocity(quantity="Velocity", unit="m/s", min=0) = 1e-3
    "Sliding speed at which the regularised friction reaches 71 % of Coulomb's";
  parameter Real tangential_damping(unit="N.s/m", min=0) = 0 "Tangential damping while in contact";
  parameter Real tip[3](each quantity="Length", each unit="m") = {0, 0, 0} "Rod tip in O_u";
  parameter Real normal[3](each unit="1") = {-1, 0, 0}
    "Normal of the front frame's surface in O_t, towards the rod; of any length above 0";
  parameter Real front(quantity="Length", unit="m") = 0.005 "Position of the front surface along -normal";
  parameter Real rear(quantity="Length", unit="m") = -0.005 "Position of the rear surface along -normal";
  parameter Boolean start_in_contact = false "Whether the rod may touch a frame at the start";
  input Real position[3](each quantity="Length", each unit="m", each start=0) "Position of O_u in O_t";
  input Real orientation[4](each unit="1", start={1, 0, 0, 0}) "Orientation of O_u in O_t, unit quaternion w, x, y, z";
  input Real velocity[3](each quantity="Velocity", each unit="m/s", each start=0) "Velocity of O_u in O_t";
  input Real angular_velocity[3](each quantity="AngularVelocity", each unit="rad/s", each start=0)
    "Angular velocity of O_u in O_t";
  output Real force[3](each quantity="Force", each unit="N") "Contact force on the rod, in O_t";
  output Real point[3](each quantity="Length", each unit="m") "Contact point, the rod tip, in O_t";
  output Real penetration(quantity="Length", unit="m") "Depth of the rod tip in the frame it touches";
  output Real stored_energy(quantity="Energy", unit="J") "Elastic energy of the contact";
protected
  parameter Real length(unit="1") = sqrt(normal*normal) "Length of the normal as given";
  parameter Real e[3](each unit="1") = normal/(if length > 0 then length else 1) "Unit normal";
  Real square(unit="1") "Squared length of the quaternion, 1 but for rounding";
  Real turned[3](each quantity="Length", each unit="m") "Rod tip seen from O_u, resolved in O_t";
  Real tip_velocity[3](each quantity="Velocity", each unit="m/s") "Velocity of the rod tip";
  Real x(quantity="Length", unit="m") "Rod tip along -normal";
  Real v(quantity="Velocity", unit="m/s") "Its velocity";
  Real sliding[3](each quantity="Velocity", each unit="m/s") "Tangential velocity of the rod tip";
  Real front_push(quantity="Force", unit="N") "Spring-damper law at the front frame, may be negative";
  Real rear_push(quantity="Force", unit="N") "Spring-damper law at the rear frame, may be negative";
  Real along(quantity="Force", unit="N") "Force on the rod along -normal";
  Real grip(unit="N.s/m") "Tangential force over sliding velocity";
  Real since_start(quantity="Time", unit="s", start=0, fixed=true) "Time since the start";
equation
  der(since_start) = 1;
  square = orientation*orientation;
  turned = (2*(orientation[2:4]*tip)*orientation[2:4]
    + (orientation[1]^2 - orientation[2:4]*orientation[2:4])*tip
    + 2*orientation[1]*cross(orientation[2:4], tip))/square;
  point = position + turned;
  tip_velocity = velocity + cross(angular_velocity, turned);
  x = -(e*point);
  v = -(e*tip_velocity);
  sliding = tip_velocity + v*e;
  front_push = stiffness*(x - front) + damping*v;
  rear_push = stiffness*(rear - x) - damping*v;
  // As in DockingContact: begins with penetration, ends where the law would pull.
  along =
    if x > front and front_push > 0 then -front_push
    elseif x < rear and rear_push > 0 then rear_push
    else 0;
  penetration =
    if x > front then x - front
    elseif x < rear then rear - x
    else 0;
  stored_energy = stiffness*penetration^2/2;
  // noEvent: the regularised law has no corner; a force of zero has no grip.
  grip = noEvent(if along < 0 or along > 0 then
      friction*abs(along)/sqrt(sliding*sliding + friction_velocity^2) + tangential_damping
    else 0);
  force = -along*e - grip*sliding;
  assert(length > 0, "normal has no length; give the direction from the front surface towards the rod, such as {-1, 0, 0}");
  assert(friction <= 0 or friction_velocity > 0, "friction_velocity is 0 m/s; with friction, allowed: above 0 m/s, such as 1 mm/s");
  assert(front > rear, "front is not above rear; allowed: front above rear, both along -normal");
  assert(square > 0.998 and square < 1.002, "orientation is no unit quaternion; give w, x, y, z of length 1");
  assert(start_in_contact or since_start > 0 or penetration <= 0,
    "the rod tip starts inside a frame; start it between rear and front, or set start_in_contact if that is meant");
  annotation (Documentation(info="<html>
<p>The rod tip p moves with O_u. Along -normal it stands at x; at the front surface it is pushed back
with F = k d + c d', d = x - front &gt; 0, at the rear one with d = rear - x &gt; 0, along the normal and never
pulled (Eqs. 20, 21 of the source without tangential parts).</p>
<p>Friction, where asked for, is Coulomb's with a corner rounded off:
F_t = -mu F v_t/sqrt(v_t^2 + v_r^2). It never does positive work. Nothing sticks: below v_r the rod
creeps.</p>
<p>A run has to start free, as the rig does: the elastic energy of a rod that starts inside a frame comes
from nowhere.</p>
</html>"));
end PointContact;
