within ;
package Drives "Linear drives and dampers: motion, cascaded control, moved mass, Coulomb friction"
  annotation (
    version="0.1.0",
    Documentation(info="<html>
<p>Components of positioning systems and of test rigs for dampers, each with the physics that a data sheet
tells: a mass on a guide with viscous friction, a cascade of position and velocity control, Coulomb friction.
Every variable carries its SI unit. Forces and voltages are positive where they push towards larger
positions; the force of a damper is that with which it has to be moved. The package needs no library, not
even the Modelica Standard Library.</p>
</html>"));
end Drives;
