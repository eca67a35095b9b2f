within Drives;
model SmoothMotion "Motion to and fro that begins at rest"
  parameter Real stroke(quantity="Length", unit="m") = 0.1 "Way between the two ends";
  parameter Real frequency(quantity="Frequency", unit="Hz", min=0) = 0.2 "Motions to and fro per second";
  output Real position(quantity="Length", unit="m") "Position; 0 m at the start, then up to the stroke";
  output Real velocity(quantity="Velocity", unit="m/s") "Its velocity";
protected
  constant Real pi(unit="rad") = 3.141592653589793;
  Real turned(unit="rad", start=0, fixed=true) "Angle of the crank that would move so";
equation
  der(turned) = 2*pi*frequency;
  position = stroke*(1 - cos(turned))/2;
  velocity = stroke*pi*frequency*sin(turned);
  annotation (Documentation(info="<html>
<p>x(t) = s (1 - cos(2 pi f t))/2: a sinusoid that begins at one end, at rest.</p>
</html>"));
end SmoothMotion;
