/* Start and stop of a module in all versions of PX4; by gustproof $version. */
#pragma once

#include <px4_platform_common/module.h>

// PX4's ModuleBase is a class template until 2025 and a class with a descriptor since. No macro tells which: overload
// resolution does.

template<template<class> class Base, class Module>
class TemplateModule : public Base<Module>
{
protected:
	static void keep(Module *instance)
	{
		Base<Module>::_object.store(instance);
		Base<Module>::_task_id = instance ? Base<Module>::task_id_is_work_queue : -1;
	}
};

template<class Base, class Module>
class DescriptorModule : public Base
{
public:
	static int main(int argc, char *argv[]) { return Base::main(descriptor(), argc, argv); }

protected:
	static void exit_and_cleanup() { Base::exit_and_cleanup(descriptor()); }

	static void keep(Module *instance)
	{
		descriptor().object.store(instance);
		descriptor().task_id = instance ? Base::task_id_is_work_queue : -1;
	}

private:
	static typename Base::Descriptor &descriptor()
	{
		static typename Base::Descriptor one{Module::task_spawn, Module::custom_command, Module::print_usage};
		return one;
	}
};

template<class T> struct ModuleKind { using Type = T; };
template<template<class> class Base, class Module> ModuleKind<TemplateModule<Base, Module>> module_kind();
template<class Base, class Module> ModuleKind<DescriptorModule<Base, Module>> module_kind();
