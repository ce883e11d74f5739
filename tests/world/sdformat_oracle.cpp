// Prints what the real SDF parser makes of each collision: its name, a tab, x y z qx qy qz qw in the world, a tab, and
// its shape: kind, the numbers that make it, and for a mesh its URI.
// Usage: sdformat_oracle FILE [FOLDER OF MODELS]
#include <cstdio>
#include <iostream>
#include <sstream>
#include <string>
#include <sdf/sdf.hh>
#include <sdf/Capsule.hh>
#include <sdf/Ellipsoid.hh>

using ignition::math::Pose3d;

static bool failed = false;

static Pose3d Solved(const sdf::SemanticPose &semantic, const std::string &to = "") {
  Pose3d pose;
  for (const auto &error : semantic.Resolve(pose, to)) {
    std::cerr << error << "\n";
    failed = true;
  }
  return pose;
}

static std::string Shape(const sdf::Geometry &of) {
  std::ostringstream out;
  out.precision(12);
  if (const auto *box = of.BoxShape()) out << "box " << box->Size();
  else if (const auto *round = of.CylinderShape()) out << "cylinder " << round->Radius() << " " << round->Length();
  else if (const auto *pill = of.CapsuleShape()) out << "capsule " << pill->Radius() << " " << pill->Length();
  else if (const auto *ball = of.SphereShape()) out << "sphere " << ball->Radius();
  else if (const auto *egg = of.EllipsoidShape()) out << "ellipsoid " << egg->Radii();
  else if (const auto *plane = of.PlaneShape()) out << "plane " << plane->Normal() << " " << plane->Size();
  else if (const auto *mesh = of.MeshShape()) out << "mesh " << mesh->Scale() << " " << mesh->Uri();
  else if (const auto *map = of.HeightmapShape()) out << "heightmap " << map->Size() << " " << map->Position();
  return out.str();
}

static void Print(const sdf::Model &model, const Pose3d &around, const std::string &outer) {
  const Pose3d here = around * Solved(model.SemanticPose());
  const std::string name = outer.empty() ? model.Name() : outer + "::" + model.Name();
  for (uint64_t i = 0; i < model.LinkCount(); ++i) {
    const sdf::Link &link = *model.LinkByIndex(i);
    const Pose3d there = here * Solved(link.SemanticPose(), "__model__");
    for (uint64_t k = 0; k < link.CollisionCount(); ++k) {
      const sdf::Collision &shape = *link.CollisionByIndex(k);
      const Pose3d p = there * Solved(shape.SemanticPose(), link.Name());
      std::printf("%s::%s::%s\t%.12g %.12g %.12g %.12g %.12g %.12g %.12g\t%s\n", name.c_str(), link.Name().c_str(),
                  shape.Name().c_str(), p.X(), p.Y(), p.Z(), p.Rot().X(), p.Rot().Y(), p.Rot().Z(), p.Rot().W(), Shape(*shape.Geom()).c_str());
    }
  }
  for (uint64_t i = 0; i < model.ModelCount(); ++i) Print(*model.ModelByIndex(i), here, name);
}

int main(int argc, char **argv) {
  if (argc > 2) sdf::addURIPath("model://", argv[2]);
  sdf::Root root;
  for (const auto &error : root.Load(argv[1])) {
    std::cerr << error << "\n";
    failed = true;
  }
  if (root.Model()) Print(*root.Model(), Pose3d::Zero, "");
  if (root.WorldCount()) {
    const sdf::World &world = *root.WorldByIndex(0);
    for (uint64_t i = 0; i < world.ModelCount(); ++i) Print(*world.ModelByIndex(i), Pose3d::Zero, "");
  }
  return failed ? 1 : 0;
}
