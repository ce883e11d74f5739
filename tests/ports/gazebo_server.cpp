// What gz-sim's server says of a world, on the real library of Gazebo Transport: poses, statistics, a scan, the scene.
// Started as PROGRAM WORLD MODEL; takes words on its standard input: pause, go, reset, delete, back, push, quit, and
// damage (20 messages cut or of other bytes, 20 poses without a number, 20 with no unit quaternion), flood (30,000
// poses at once, a millisecond apart). After push the wall comes nearer by half a metre a second, as far as x = 2.
// Prints what it hears on the range topic of the model's front radar.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <iostream>
#include <string>
#include <thread>

#include <ignition/msgs.hh>
#include <ignition/transport.hh>

namespace msgs = ignition::msgs;
std::atomic<bool> paused{false}, gone{false}, done{false};
std::atomic<long> step{0}, pushed{-1}, damaged{0};
std::atomic<bool> flood{false};

void box(msgs::Model *model, const std::string &name, double x, double size_x, double size_y)
{
  model->set_name(name);
  model->mutable_pose()->mutable_position()->set_x(x);
  model->mutable_pose()->mutable_orientation()->set_w(1);
  auto *link = model->add_link();
  link->set_name("link");
  auto *visual = link->add_visual();
  visual->set_name("visual");
  visual->set_laser_retro(0.7);
  visual->mutable_geometry()->set_type(msgs::Geometry::BOX);
  auto *size = visual->mutable_geometry()->mutable_box()->mutable_size();
  size->set_x(size_x);
  size->set_y(size_y);
  size->set_z(3);
}

int main(int, char **argv)
{
  const std::string world = argv[1], model = argv[2], root = "/world/" + world;
  ignition::transport::Node node;
  auto poses = node.Advertise<msgs::Pose_V>(root + "/pose/info");
  auto stats = node.Advertise<msgs::WorldStatistics>(root + "/stats");
  auto scans = node.Advertise<msgs::LaserScan>(root + "/model/" + model + "/link/base/sensor/front/scan");
  std::function<bool(msgs::Scene &)> tell = [&](msgs::Scene &scene) {
    scene.set_name(world);
    box(scene.add_model(), "wall", 4, 0.2, 6);
    box(scene.add_model(), model, 0, 0.2, 0.2);
    return true;
  };
  node.Advertise(root + "/scene/info", tell);
  std::function<void(const msgs::Double &)> hear = [](const msgs::Double &range) {
    std::cout << "range " << range.data() << " at " << range.header().stamp().sec() << std::endl;
  };
  node.Subscribe("/model/" + model + "/radar/front/range", hear);

  std::thread commands([&] {
    for (std::string word; !done && std::cin >> word;)
    {
      if (word == "pause") paused = true;
      if (word == "go") paused = false;
      if (word == "reset") step = 0;
      if (word == "delete") gone = true;
      if (word == "back") gone = false;
      if (word == "push") pushed = step.load();
      if (word == "damage") damaged = 20;
      if (word == "flood") flood = true;
      if (word == "quit") done = true;
    }
    done = true;
  });
  for (long turn = 0; !done; ++turn)
  {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    if (!paused) ++step;
    const long now = step;
    msgs::Pose_V all;
    all.mutable_header()->mutable_stamp()->set_sec(now / 50);
    all.mutable_header()->mutable_stamp()->set_nsec(now % 50 * 20000000);
    auto *other = all.add_pose();
    other->set_name("wall");
    other->mutable_position()->set_x(pushed < 0 ? 4 : std::max(2.0, 4 - 0.01 * (now - pushed)));
    other->mutable_orientation()->set_w(1);
    if (!gone)
    {
      auto *own = all.add_pose();
      own->set_name(model);
      own->mutable_position()->set_x(std::sin(0.01 * now));  // to and fro, half a metre a second
      own->mutable_orientation()->set_w(1);
    }
    if (damaged > 0)
    {
      --damaged;
      const std::string whole = all.SerializeAsString(), kind = "ignition.msgs.Pose_V";
      poses.PublishRaw(damaged % 2 ? whole.substr(0, whole.size() - 3) : std::string(40, '\xff'), kind);
      msgs::Pose_V nowhere = all, turned = all;
      for (auto &pose : *nowhere.mutable_pose()) pose.mutable_position()->set_y(std::nan(""));
      for (auto &pose : *turned.mutable_pose()) pose.mutable_orientation()->set_w(2);
      nowhere.mutable_header()->mutable_stamp()->set_nsec(now % 50 * 20000000 + 1000);
      turned.mutable_header()->mutable_stamp()->set_nsec(now % 50 * 20000000 + 2000);
      poses.Publish(nowhere);
      poses.Publish(turned);
    }
    for (long k = 0; flood && k < 30000; ++k)
    {
      const long now_ms = 20 * step + k;
      all.mutable_header()->mutable_stamp()->set_sec(now_ms / 1000);
      all.mutable_header()->mutable_stamp()->set_nsec(now_ms % 1000 * 1000000);
      poses.Publish(all);
    }
    if (flood.exchange(false)) step += 1501;
    poses.Publish(all);
    if (turn % 5) continue;
    msgs::WorldStatistics told;
    told.set_paused(paused);
    told.mutable_sim_time()->CopyFrom(all.header().stamp());
    stats.Publish(told);
    msgs::LaserScan scan;  // of a wall across at x = 3.9
    scan.mutable_header()->CopyFrom(all.header());
    const int side = 9;
    const double half = 0.5;
    scan.set_count(side);
    scan.set_vertical_count(side);
    scan.set_angle_min(-half);
    scan.set_angle_max(half);
    scan.set_range_min(0.1);
    scan.set_range_max(10);
    for (int up = 0; up < side; ++up)
      for (int across = 0; across < side; ++across)
      {
        const double step_rad = 2 * half / (side - 1);
        scan.add_ranges((3.9 - std::sin(0.01 * now)) / std::cos(-half + up * step_rad) / std::cos(-half + across * step_rad));
        scan.add_intensities(0.7);
      }
    scans.Publish(scan);
  }
  commands.detach();
  std::_Exit(0);
}
